"""``trajopt discover``: what it prints and writes, and what it refuses."""

import json
from pathlib import Path

import pytest

from tests.support.command_lines import assert_refused, invoke
from trajopt.motion.solution import Solution
from trajopt.schedule import Schedule

pytestmark = pytest.mark.long

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
