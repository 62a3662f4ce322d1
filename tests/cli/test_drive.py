"""The command ``trajopt drive``: exit status, JSON, a file that others read, one line for bad input."""

import json
from pathlib import Path

import pytest

from tests.support.command_lines import assert_refused, invoke
from trajopt import Solution

pytestmark = pytest.mark.long

# Feet on the ground sink into it by less, m.
GIVES_WAY = 2e-3
# Mean distance of a tool from its moving target, m.
ERROR = 0.02
TROT = "time,gait,speed\n0,,\n0.1,trot,0.4\n"


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("drive") / "trot.csv"
    file.write_text(TROT)
    return file


@pytest.fixture(scope="module")
def run(script) -> Path:
    """A file of a drive, beside what the command printed."""
    file = script.parent / "run.npz"
    options = ("--push", "0.2,90,2", "--push", "0.3,180,2", "--friction-scale", 0.9, "--mass-scale", 1.05)
    noise = ("--sensor-noise", 1e-4, "--seed", 3, "--delay", 1, "--com-offset", 0.005, 0, 0)
    done = invoke(
        "drive", "go2", "--script", script, "--seconds", 0.6, "-o", file, "--json", *options, *noise
    )
    assert done.exit_code == 0, done.stderr
    file.with_suffix(".json").write_text(done.stdout)
    return file


def test_json_is_one_object_with_the_figures_of_the_report(run):
    figures = json.loads(run.with_suffix(".json").read_text())
    assert figures["passed"] is True
    assert figures["fell"] is False
    assert figures["plans"] == 60
    assert figures["simulated"] == pytest.approx(0.6)
    assert figures["script"]["commands"][1]["gait"] == "trot"


def test_others_read_the_file(run):
    motion = Solution.load(run)
    assert motion.statistics.simulated
    assert invoke("replay", run, "--html", run.with_suffix(".html")).exit_code == 0
    assert invoke("plot", run, "-o", run.with_suffix(".png")).exit_code == 0
    assert invoke("export", run, "-o", run.with_suffix(".csv")).exit_code == 0
    checked = invoke("check", run, "--json")
    assert checked.exit_code == 1  # feet slip and give way in physics
    assert json.loads(checked.stdout)["penetration"] < GIVES_WAY


def test_a_robot_that_falls_ends_with_one_and_the_reason(script):
    done = invoke("drive", "go2", "--script", script, "--period", 0.05, "--push", "0.1,90,100")
    assert done.exit_code == 1
    assert done.output.splitlines()[-1].startswith("it fell at 0.")


def test_an_arm_follows_the_targets_of_a_script(tmp_path):
    script, run = tmp_path / "targets.csv", tmp_path / "run.npz"
    script.write_text("time, x, y, z\n0, 0.4, 0, 0.4\n0.3, , 0.1,\n")
    done = invoke("drive", "panda", "--script", script, "--seconds", 0.6, "-o", run, "--json")
    assert done.exit_code == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["passed"] is True
    assert figures["simulated"] == pytest.approx(0.6)
    assert figures["targets"] == [[0.0, [0.4, 0.0, 0.4]], [0.3, [0.4, 0.1, 0.4]]]
    assert figures["error_mean"] < ERROR
    assert invoke("replay", run, "--html", run.with_suffix(".html")).exit_code == 0
    assert invoke("plot", run, "-o", run.with_suffix(".png")).exit_code == 0
    assert invoke("export", run, "-o", run.with_suffix(".csv")).exit_code == 0


def test_an_arm_goes_around_a_post_that_stands_in_its_way(tmp_path):
    """The target goes straight through the post; joints keep their rates while the tool makes a detour."""
    script, run = tmp_path / "targets.csv", tmp_path / "run.npz"
    script.write_text("time,x,y,z\n0,0.55,0,0.5\n0.2,0.4,0.36,0.4\n")
    post = "0.45,0.15,0.6,0.04"
    done = invoke("drive", "panda", "--script", script, "--seconds", 1.2, "--post", post, "-o", run, "--json")
    assert done.exit_code == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["nearest"] > 0.01
    assert figures["rate"] <= 1.01
    assert figures["beyond"] == 0.0
    (obstacle,) = Solution.load(run).description.obstacles
    assert obstacle.radius == 0.04


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("time,x,y,z\n0,0.4,0\n", "line 2: '0,0.4,0'; allowed"),
        ("time,x,y,z\n0,0.4,0,0.4\n1,nan,0,0\n", "line 3: '1,nan,0,0'; allowed"),
        ("time,x,y,z\n0,,0,0.4\n", "line 2: '0,,0,0.4'; allowed"),
        ("time,x,y,z\n", "times of targets are []; allowed"),
        ("time,x,y,z\n1,0.4,0,0.4\n", "times of targets are [1.0]; allowed: the first 0, then increasing"),
        ("time,x,y,z\n0,9,0,0.4\n", "x is 9.0; allowed: -0.07451 to 0.6883 m"),
        ("", "its first line is ''; allowed"),
    ],
)
def test_targets_that_do_not_fit_are_one_line(text, line, tmp_path):
    script = tmp_path / "targets.csv"
    script.write_text(text)
    assert_refused(invoke("drive", "panda", "--script", script), line)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["go2", "--script", "missing.csv"], "missing.csv cannot be read: No such file or directory"),
        (["nobody", "--script", "CSV"], "robot 'nobody' is unknown"),
        (
            ["ur5", "--script", "CSV"],
            "its first line is 'time,gait,speed'; allowed: a CSV file",
        ),
        (["ur5", "--script", "CSV", "--push", "0,0,1"], "--push with 'ur5', an arm"),
        (["ur5", "--script", "CSV", "--rolling"], "--rolling with 'ur5', an arm"),
        (["go2", "--script", "CSV", "--post", "1,0,1,0.1"], "--post with 'go2', on legs"),
        (["go2", "--post", "1,0,1,0.1"], "--post without --target"),
        (["ur5", "--target", "--post", "1,0,1"], "--post is '1,0,1'; allowed: X,Y,HEIGHT,RADIUS, numbers"),
        (["ur5", "--target", "--post", "1,0,0.1,0.1"], "allowed: a radius above 0, and a height above twice"),
        (["talos", "--script", "CSV"], "line 3: gait is 'trot'; allowed: stand, walk, run"),
        (["go2", "--script", "CSV", "--seconds", "0"], "--seconds is 0 s; allowed: finite and > 0"),
        (["go2", "--script", "CSV", "--seconds", "soon"], "Invalid value for '--seconds'"),
        (["go2", "--script", "CSV", "--period", "0"], "period of ControllerSettings is 0.0"),
        (["go2", "--script", "CSV", "--push", "1,2"], "--push is '1,2'; allowed: TIME,DEGREES,SIZE, numbers"),
        (["go2", "--script", "CSV", "--push", "1,0,-2"], "size of Impulse is -2.0"),
        (["go2", "--script", "CSV", "--push", "99,0,1"], "an impulse at 99 s is after the simulation"),
        (["go2", "--script", "CSV", "--slope", "80"], "slope is 80 degrees; allowed: -60 to 60"),
        (["go2", "--script", "CSV", "--boxes", "3"], "part of boxes_ahead is 3.0"),
        (["go2", "--script", "CSV", "--boxes", "0.1", "--slope", "5"], "--slope and --boxes are both given"),
        (["go2", "--script", "CSV", "--seed", "3"], "--seed has no effect here"),
        (
            ["go2", "--script", "CSV", "--delay", "101"],
            "delay of SimulationSettings is 101",
        ),
        (["go2", "--script", "CSV", "-o", "CSV"], "is an input file"),
        (["go2", "--script", "CSV", "-o", "/no/such/folder/x.npz"], "cannot write /no/such/folder/x.npz"),
    ],
)
def test_bad_input_ends_with_two_and_one_line(arguments, line, script):
    assert_refused(invoke("drive", *[script if word == "CSV" else word for word in arguments]), line)
