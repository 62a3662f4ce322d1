"""What functions that show, draw or run a solution take, and what they refuse in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems_for_tests import one_joint_arm
from synthetic import arm_motion, sampled

from trajopt.errors import InputError
from trajopt.plotting import report
from trajopt.replay import replay
from trajopt.replay.render import render
from trajopt.simulation import simulate
from trajopt.solution import OTHERS, SAMPLED, Solution


@pytest.fixture(scope="module")
def plan() -> Solution:
    robot = one_joint_arm()
    return sampled(robot, [arm_motion(robot)], 2)


def shown(solutions, folder):
    return replay(solutions, html=folder / "a.html")


def drawn(solutions, folder):
    return report(solutions, folder / "a.png")


def pictured(solutions, folder):
    return render(solutions, folder / "a.png")


def ran(solutions, _):
    return simulate(solutions)


EVERY = [shown, drawn, pictured, ran]


@pytest.mark.parametrize("use", EVERY)
@pytest.mark.parametrize("given", [None, 3, [3], [None]])
def test_what_is_no_solution_is_refused_in_one_line(use, given, tmp_path):
    with pytest.raises(InputError, match="is no solution; allowed: a Solution or the path") as refused:
        use(given, tmp_path)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("use", EVERY)
@pytest.mark.parametrize("count", [0, 1])
def test_less_than_two_samples_are_refused(use, count, plan, tmp_path):
    arrays = {name: getattr(plan, name)[:count] for name in SAMPLED}
    few = replace(plan, **arrays, **dict.fromkeys(set(OTHERS) - {"interval_t"}))
    with pytest.raises(InputError, match=f"has {count} samples; allowed: two or more"):
        use(few, tmp_path)


@pytest.mark.parametrize("use", [shown, pictured, ran])
@pytest.mark.parametrize("name", ["q", "tau"])
def test_motion_that_is_not_finite_is_neither_shown_nor_run(use, name, plan, tmp_path):
    values = np.array(getattr(plan, name))
    values[1] = np.nan
    with pytest.raises(InputError, match=f"'{name}' of the solution holds NaN"):
        use(replace(plan, **{name: values}), tmp_path)


def test_paths_of_files_do_as_well(plan, tmp_path):
    file = plan.save(tmp_path / "plan.npz")
    alone = shown(file, tmp_path).html.read_text()
    assert shown(str(file), tmp_path).html.read_text() == alone
    assert shown(plan, tmp_path).html.read_text() == alone
    assert shown([plan, file], tmp_path).facts["runs"][1]["label"]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"colour": 3}, "a rendering has no option colour; allowed: size, fps, "),
        ({"size": "640x480"}, "size is '640x480'; allowed: (width, height) in whole pixels"),
        ({"size": (640.5, 480)}, "size is (640.5, 480); allowed"),
        ({"strip": 2.5}, "a strip of 2.5 pictures; allowed: 2 to 32"),
        ({"time": "late"}, "time is 'late'; allowed: a number"),
        ({"speed": "fast"}, "speed is 'fast'; allowed: a number"),
        ({"speed": None}, "speed is None"),
    ],
)
def test_options_of_a_rendering_of_another_kind_are_refused(options, line, plan, tmp_path):
    with pytest.raises(InputError) as refused:
        render(plan, tmp_path / "a.png", **options)
    assert str(refused.value).startswith(line)


@pytest.mark.parametrize("speed", ["fast", None, 0, -1.0, float("nan")])
def test_speed_that_is_no_positive_number_is_refused(speed, plan, tmp_path):
    with pytest.raises(InputError, match=r"speed is .*; a positive number; 1 is real time"):
        replay(plan, html=tmp_path / "a.html", speed=speed)
