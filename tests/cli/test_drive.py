"""``trajopt drive``, ``simulate`` and ``discover``: exit status, JSON, files, one line for bad input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.synthetic_motions import sampled, standing
from trajopt import Schedule, Solution
from trajopt_library import robots

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
    ("name", "payload", "lines", "at"),
    [
        ("go2", "5,base,0.1,0,0.1", TROT, (1, [0.1, 0.0, 0.1])),
        ("panda", "2", "time,x,y,z\n0,0.4,0,0.4\n", (7, None)),
    ],
)
def test_a_payload_is_carried_by_the_link_of_its_frame(name, payload, lines, at, tmp_path):
    """It is part of the link in the plant and in the model of the controller, which has no steady error."""
    script, run = tmp_path / "script.csv", tmp_path / "run.npz"
    script.write_text(lines)
    done = invoke(
        "drive", name, "--script", script, "--seconds", 0.5, "--payload", payload, "-o", run, "--json"
    )
    assert done.exit_code == 0, done.stderr
    figures, (link, place) = json.loads(done.stdout), at
    assert figures["passed"] is True
    assert figures.get("error_mean", 0.0) < ERROR
    own, model, mass = robots.load(name).model, Solution.load(run).model, float(payload.split(",")[0])
    added = model.inertias[link] - own.inertias[link]
    assert added.mass == pytest.approx(mass)
    assert place is None or added.lever == pytest.approx(place)


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
        (["ur5", "--script", "CSV", "--start", "lying"], "--start with 'ur5', an arm"),
        (["panda", "--target", "--start", "lying"], "robot 'panda' cannot lie; allowed: a quadruped"),
        (["go2", "--script", "CSV", "--post", "1,0,1,0.1"], "--post with 'go2', on legs"),
        (["go2", "--post", "1,0,1,0.1"], "--post without --target"),
        (["ur5", "--target", "--post", "1,0,1"], "--post is '1,0,1'; allowed: X,Y,HEIGHT,RADIUS, numbers"),
        (["ur5", "--target", "--post", "1,0,0.1,0.1"], "allowed: a radius above 0, and a height above twice"),
        (["talos", "--script", "CSV"], "line 3: gait is 'trot'; allowed: stand, walk, run"),
        (["go2", "--script", "CSV", "--seconds", "0"], "--seconds is 0 s; allowed: finite and > 0"),
        (["go2", "--script", "CSV", "--seconds", "soon"], "Invalid value for '--seconds'"),
        (["go2", "--script", "CSV", "--period", "0"], "period of ControllerSettings is 0.0"),
        (["go2", "--script", "CSV", "--payload", "1,base,2"], "place of a payload is [2.0]; allowed: 3"),
        (["go2", "--script", "CSV", "--payload", "a"], "--payload is 'a'; allowed: MASS[,FRAME[,X,Y,Z]]"),
        (["go2", "--payload", "-1"], "mass of a payload is -1 kg; allowed: finite and >= 0"),
        (["go2", "--script", "CSV", "--payload", "1,nose"], "a payload names frame 'nose'"),
        (["go2", "--script", "CSV", "--push", "1,2"], "--push is '1,2'; allowed: TIME,DEGREES,SIZE, numbers"),
        (["go2", "--script", "CSV", "--push", "1,0,-2"], "size of Impulse is -2.0"),
        (["go2", "--script", "CSV", "--push", "99,0,1"], "an impulse at 99 s is after the simulation"),
        (["go2", "--script", "CSV", "--slope", "80"], "slope is 80 degrees; allowed: -60 to 60"),
        (["go2", "--script", "CSV", "--boxes", "3"], "part of boxes_ahead is 3.0"),
        (["go2", "--script", "CSV", "--boxes", "0.1", "--slope", "5"], "--slope and --boxes are both given"),
        (["go2", "--script", "CSV", "--seed", "3"], "--seed has no effect here"),
        (["go2", "--script", "CSV", "--terrain", "hills"], "--terrain is 'hills'; allowed: steps, stairs"),
        (["go2", "--script", "CSV", "--terrain", "gap:width=1", "--slope", "5"], "--slope and --terrain are"),
        (["go2", "--terrain", "stairs:rise=0.1"], "--terrain 'stairs:rise=0.1' has the wrong form"),
        (["panda", "--target", "--terrain", "gap:width=1"], "--terrain with --target; allowed: with a robot"),
        (["talos", "--terrain", "gap:width=1"], "robot 'talos' has soles; allowed: point feet"),
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


@pytest.fixture(scope="module")
def stand(tmp_path_factory) -> Path:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4).save(tmp_path_factory.mktemp("plan") / "stand.npz")


@pytest.fixture(scope="module")
def limp(stand: Path) -> Path:
    """The same posture without torques."""
    plan = Solution.load(stand)
    return replace(plan, tau=np.zeros_like(plan.tau)).save(stand.parent / "limp.npz")


def simulated(*arguments: object) -> Result:
    return invoke("simulate", *arguments)


def test_tracked_plan_ends_with_zero_and_says_so(stand):
    result = simulated(stand)
    assert result.exit_code == 0
    assert result.output.splitlines()[-1] == "tracked"


def test_robot_that_falls_ends_with_one_and_the_reason(limp):
    result = simulated(limp, "--kp", 0, "--kd", 0)
    assert result.exit_code == 1
    assert result.output.splitlines()[-1].startswith("not tracked: ")


def test_json_of_simulate_is_one_object_with_the_figures_of_the_report(stand):
    result = simulated(stand, "--json")
    figures = json.loads(result.output)
    assert figures["passed"] is True
    assert figures["fell"] is False
    assert figures["base_error_end"] < 1e-3
    assert [contact["frame"] for contact in figures["contacts"]] == Solution.load(stand).meta[
        "contact_frames"
    ]


def test_simulated_motion_is_written_as_a_solution_file(stand, tmp_path):
    target = tmp_path / "simulated.npz"
    assert simulated(stand, "-o", target).exit_code == 0
    assert Solution.load(target).statistics.simulated is True


def test_page_shows_plan_and_simulation(stand, tmp_path):
    target = tmp_path / "both.html"
    assert simulated(stand, "--html", target).exit_code == 0
    page = target.read_text()
    assert "plan" in page
    assert "simulation" in page
    assert page.count("<html") == 1


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["missing.npz"], "missing.npz does not exist"),
        (
            ["PLAN", "--kp", "-1"],
            "kp of SimulationSettings is -1.0; allowed: a finite number from 0 to 1e+06",
        ),
        (["PLAN", "--cycles", "0"], "cycles of SimulationSettings is 0; allowed: a whole number >= 1"),
        (["PLAN", "--cycles", "2"], "the solution is not periodic; allowed: --cycles 1"),
        (["PLAN", "-o", "PLAN"], "is an input file"),
        (["PLAN", "-o", "x.npz", "--html", "./x.npz"], "x.npz is written twice"),
        (["PLAN", "--noise", "a lot"], "Invalid value for '--noise'"),
        (["PLAN", "-o", "/no/such/folder/x.npz"], "cannot write /no/such/folder/x.npz"),
        (["PLAN", "--html", "/no/such/folder/x.html"], "cannot write /no/such/folder/x.html"),
    ],
)
def test_bad_input_of_simulate_ends_with_two_and_one_line(arguments, line, stand):
    assert_refused(simulated(*[stand if word == "PLAN" else word for word in arguments]), line)


QUICK = ("--seeds", 1, "--jobs", 1)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_best_is_printed_and_written(folder: Path) -> None:
    result = invoke("discover", "hopper-hop", *QUICK, "--schedule-out", "hop.py", "--output", "hop.npz")
    assert result.exit_code == 0
    assert "certified" in result.stdout
    assert "candidates" in result.stdout.splitlines()[-1]
    scope: dict[str, Schedule] = {}
    exec(Path("hop.py").read_text(), scope)
    solution = Solution.load("hop.npz")
    assert solution.success
    assert [phase.name for phase in scope["SCHEDULE"].phases] == list(solution.phase_names)


def test_json_has_every_candidate_and_resuming_tries_none_again(folder: Path) -> None:
    words = ("discover", "hopper-hop", *QUICK, "--output-dir", "found", "--json")
    first, again = (json.loads(invoke(*words, *more).stdout) for more in ((), ("--resume",)))
    assert first == again
    assert {each["source"] for each in first["candidates"]} >= {"relaxed:0", "hop"}
    assert (folder / "found" / "relaxed-0.npz").exists()
    assert_refused(invoke(*words), "allowed: --resume, or another folder")


def test_a_goal_that_is_too_far_ends_with_the_part_of_the_way_that_is_reached(folder: Path) -> None:
    result = invoke("discover", "hopper", "--goal", "x=1.5", "--time", 1.2, "--seeds", 0, "--jobs", 1)
    assert result.exit_code == 1
    assert "of the way is reached" in result.stdout.splitlines()[-1]


def test_a_cycle_of_a_robot_is_found(folder: Path) -> None:
    result = invoke("discover", "hopper", "--periodic", "--set", "speed=0.5", *QUICK)
    assert result.exit_code == 0
    assert "nearest known gait of the best: hop" in result.stdout


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("go2", "--set", "a=1"), "--set has no effect on the robot"),
        (("hopper-hop", "--goal", "x=1"), "--goal has no effect on the problem"),
        (("hopper-hop", "--terrain", "flat"), "--terrain has no effect on the problem"),
        (("hopper-hop", "--time", "1"), "--time has no effect on the problem"),
        (("hopper-hop", "--jobs", 1, "--scheduler", "tcp://127.0.0.1:1"), "allowed: without --scheduler"),
        (("go2", "--goal", "z=1"), "a goal has no 'z'"),
        (("go2",), "the robot 'go2' has no goal; allowed: --goal x=METRES, y=METRES or yaw=RADIANS"),
        (("go2", "--goal", "x=nan"), "parameter x is nan; allowed: -1000 to 1000 m"),
        (("go2", "--goal", "x=0.5kg"), "parameter x='0.5kg' is not a number; allowed: -1000 to 1000 m"),
        (("quadruped-trot", "speed=0.5"), "'speed=0.5' stands alone; allowed: --set speed=0.5"),
        (("go2", "--terrain", "box"), "has the wrong form"),
        (("go2", "--terrain", "gap:height=1"), "has the wrong form"),
        (("go2", "--terrain", "box:height=inf"), "parameter height is inf"),
        (("go2", "--time", "2:1"), "--time is '2:1'"),
        (("go2", "--time", "nan"), "--time is 'nan'"),
        (("hopper", "--periodic"), "a cycle has no speed"),
        (("hopper", "--periodic", "--set", "speed=1", "--set", "a=1"), "a cycle has no 'a'"),
        (("hopper", "--periodic", "--set", "speed=1", "--goal", "x=1"), "--goal has no effect on a cycle"),
        (("hopper", "--periodic", "--set", "speed=1", "--time", "1:2"), "the period of a cycle is 1 to 2 s"),
        (("quadruped", "--periodic", "--set", "speed=1"), "the robot of 'quadruped' is not clear"),
        (("hopper-hop", "--periodic"), "--periodic has no effect on the problem"),
        (("hopper-hop", "--resume"), "with --output-dir"),
        (("ur5-reach",), "no feet on a moving base"),
        (("hopper-hop", "--seeds", "0", "--no-known"), "nothing is proposed"),
        (("hopper-hop", "--max-time", "nan"), "max_time"),
        (("hopper-hop", "--effort", "0"), "allowed: seeds or known ones, most >= 1"),
        (("hopper-hop", "--scheduler", "nowhere"), "no scheduler answers at 'nowhere'"),
        (("hopper-hop", "--scheduler", "a:1", "--jobs", "2"), "--jobs has no effect here"),
        (("hopper-hop", "--output", "none/x.npz"), "cannot write none/x.npz"),
        (("nothing",), "is unknown"),
    ],
)
def test_what_is_refused_is_one_line(words: tuple[str, ...], reason: str) -> None:
    assert_refused(invoke("discover", *words), reason)
