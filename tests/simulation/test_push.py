"""Largest pushes: search, directions, units, robots in a plane, bad input, the plot and the command."""

import json
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.command_lines import assert_refused, invoke
from tests.support.synthetic_motions import arm_motion, planar_flight, sampled, standing, tumbling_flight
from trajopt import Solution
from trajopt.errors import InputError
from trajopt.robot.mujoco_package import muted_mujoco
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation.push import (
    AFTER,
    DURATION,
    FIRST,
    LEAST,
    MOST,
    PushReport,
    PushTrials,
    largest_pushes,
    largest_survived,
)
from trajopt.simulation.settings import Impulse
from trajopt.simulation.simulate import simulate
from trajopt.view.plotting.writing import write_push_plot
from trajopt_library import robots

# Relative accuracy of a search.
ACCURACY = 0.05
# MuJoCo integrates the force of an impulse exactly, up to rounding and its solver's tolerance.
MOMENTUM = 1e-6


@pytest.fixture(scope="module")
def stand() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4)


@pytest.fixture(scope="module")
def plane() -> Solution:
    robot = robots.load("hopper")
    return sampled(robot, [planar_flight(robot)], 4)


@pytest.mark.parametrize("threshold", [0.0032, 0.01, FIRST, 0.07, 0.33, 1.9])
def test_the_threshold_is_found_to_the_accuracy(threshold: float) -> None:
    tried: list[float] = []

    def survives(size: float) -> bool:
        tried.append(size)
        return size <= threshold

    found = largest_survived(survives, ACCURACY)
    assert found <= threshold <= (1 + ACCURACY) * found
    assert len(tried) <= 12


def test_what_is_never_or_always_survived_ends_at_the_limits() -> None:
    assert largest_survived(lambda size: False, ACCURACY) == 0.0
    assert largest_survived(lambda size: size < LEAST / 2, ACCURACY) == 0.0
    assert largest_survived(lambda size: True, ACCURACY) == MOST


def test_all_smaller_pushes_that_were_tried_were_survived() -> None:
    tried: dict[float, bool] = {}

    def survives(size: float) -> bool:
        tried[size] = size < 0.12 or 0.17 < size < 0.19 or size > 0.3
        return tried[size]

    found = largest_survived(survives, ACCURACY)
    assert found < 0.12
    assert all(kept for size, kept in tried.items() if size <= found)


@pytest.mark.parametrize(("degrees", "along"), [(0, (1, 0)), (90, (0, 1)), (180, (-1, 0)), (225, (-1, -1))])
def test_an_impulse_is_the_momentum_that_a_robot_gains_in_its_direction(
    degrees: float, along: tuple[float, float]
) -> None:
    robot = robots.load("solo12")
    plan = sampled(robot, [tumbling_flight(robot, 0.1)], 4)
    push = Impulse(direction=math.radians(degrees), size=0.2, time=0.0, duration=0.02)
    found = {
        pushed: simulate(plan, kp=0.0, kd=0.0, impulse=push if pushed else None) for pushed in (True, False)
    }
    model = plan.model
    momentum = {
        pushed: pin.computeCentroidalMomentum(
            model, model.createData(), one.as_solution().q[-1], one.as_solution().v[-1]
        ).linear.copy()
        for pushed, one in found.items()
    }
    wanted = 0.2 * np.array([*along, 0.0]) / np.linalg.norm(along)
    heading = plan.q[0, 3:7]
    turned = pin.Quaternion(heading / np.linalg.norm(heading)).toRotationMatrix()
    yaw = pin.utils.rotate("z", math.atan2(turned[1, 0], turned[0, 0]))
    np.testing.assert_allclose(momentum[True] - momentum[False], yaw @ wanted, atol=MOMENTUM)


def test_several_impulses_are_their_sum() -> None:
    robot = robots.load("solo12")
    plan = sampled(robot, [tumbling_flight(robot, 0.1)], 4)
    forward, left, backward, further = (
        Impulse(direction=angle, size=size, time=0.01, duration=0.02)
        for angle, size in ((0.0, 0.1), (math.pi / 2, 0.1), (math.pi, 0.1), (math.pi / 2, 0.2))
    )
    ends = {
        given: simulate(plan, kp=0.0, kd=0.0, impulse=given).record.qvel[-1]
        for given in (left, further, (forward, left, backward), (left, left))
    }
    np.testing.assert_allclose(ends[forward, left, backward], ends[left], atol=MOMENTUM)
    np.testing.assert_allclose(ends[left, left], ends[further], atol=MOMENTUM)
    assert np.abs(ends[further] - ends[left]).max() > 0.01


@pytest.mark.long
def test_a_push_to_the_left_moves_the_base_to_the_left(stand: Solution) -> None:
    still = simulate(stand).record.qpos
    pushed = simulate(
        stand, impulse=Impulse(direction=math.pi / 2, size=0.3, time=0.05, duration=0.02)
    ).record.qpos
    moved = pushed - still
    assert moved[:, 1].max() > 1e-3
    assert np.abs(moved[:, 0]).max() < 0.2 * moved[:, 1].max()
    assert not moved[:50].any()


@pytest.mark.long
def test_a_standing_robot_is_pushed_where_it_stands(stand: Solution) -> None:
    report = largest_pushes(stand, controllers=["joints"], directions=2, accuracy=0.5)
    units = NaturalUnits.of(stand.model)
    assert report.unit == pytest.approx(units.weight * units.time)
    assert report.time == pytest.approx(0.1)
    assert report.duration == pytest.approx(DURATION * units.time, abs=1e-3)
    assert report.after == pytest.approx(AFTER * units.time, abs=2e-3)
    assert report.directions == (0.0, 180.0)
    assert set(report.impulses) == {"joints"}
    assert min(report.impulses["joints"]) > 0.1 * report.unit
    assert report.ratios == ()
    again = simulate(
        stand, impulse=Impulse(direction=0.0, size=10 * report.unit, time=0.1, duration=report.duration)
    )
    assert again.report.fell


@pytest.mark.long
def test_trials_do_not_depend_on_those_before(stand: Solution) -> None:
    with muted_mujoco():
        survives = PushTrials.of(stand, 0.05, None).with_controller("whole-body")
        found = [survives(30.0, size) for size in (0.02, 3 * MOST, 0.02)]
    assert found == [True, False, True]


def test_a_robot_in_a_plane_is_pushed_forward_and_backward(plane: Solution) -> None:
    report = largest_pushes(plane, controllers=["joints"], time=0.2, accuracy=1.0)
    assert report.directions == (0.0, 180.0)
    with pytest.raises(InputError, match="directions of largest_pushes is 8, of a robot in a plane"):
        largest_pushes(plane, directions=8)


def test_bad_input_is_one_line(stand: Solution) -> None:
    with pytest.raises(InputError, match=r"a push at 3 s is outside of the motion; allowed: 0 to 0\.1 s"):
        largest_pushes(stand, time=3.0)
    for arguments in ({"controllers": "arms"}, {"directions": 0}, {"accuracy": 0.0}, {"time": math.nan}):
        with pytest.raises(InputError, match="of largest_pushes"):
            largest_pushes(stand, **arguments)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="controllers of largest_pushes is empty"):
        largest_pushes(stand, controllers=[])
    with pytest.raises(InputError, match="not periodic"):
        largest_pushes(stand, cycles=3)
    arm = robots.load("ur5")
    with pytest.raises(InputError, match="a push on the base, which is fixed"):
        largest_pushes(sampled(arm, [arm_motion(arm)], 4))
    with pytest.raises(InputError, match="impulse of SimulationSettings is 3"):
        simulate(stand, impulse=3)
    late = Impulse(direction=0.0, size=1.0, time=9.0, duration=0.02)
    with pytest.raises(InputError, match="an impulse at 9 s is after the simulation"):
        simulate(stand, impulse=late)
    with pytest.raises(InputError, match="an impulse on the base, which is fixed"):
        simulate(sampled(arm, [arm_motion(arm)], 4), impulse=late)


def report_of(**changes: object) -> PushReport:
    settled = {
        "problem": "trot",
        "robot": "dog",
        "time": 1.0,
        "duration": 0.03,
        "after": 1.6,
        "cycles": 6,
        "unit": 40.0,
        "most": 80.0,
        "directions": (0.0, 90.0, 180.0, 270.0),
        "impulses": {"joints": (4.0, 2.0, 0.0, 8.0), "whole-body": (8.0, 4.0, 2.0, 80.0)},
        "notes": (),
    }
    return PushReport(**{**settled, **changes})  # type: ignore[arg-type]


def test_the_table_has_both_units_ratios_and_bounds() -> None:
    lines = report_of(notes=("it fell",)).table().splitlines()
    assert lines[2].split() == ["0", "forward", "4", "(0.100)", "8", "(0.200)", "2"]
    assert lines[4].split() == ["180", "backward", "0", "(0.000)", "2", "(0.050)", "-"]
    assert ">= 80 (2.000)" in lines[5]
    assert lines[-1] == "note: it fell"
    figures = report_of().to_dict()
    assert figures["natural"]["joints"] == [0.1, 0.05, 0.0, 0.2]
    assert figures["ratios"] == [2.0, 2.0, None, 10.0]


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_plot_is_written_and_twice_the_same(ending: str, tmp_path: Path) -> None:
    first = write_push_plot(report_of(), tmp_path / f"a.{ending}")
    second = write_push_plot(report_of(), tmp_path / f"b.{ending}")
    assert first.stat().st_size > 1000
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.long
def test_the_command_prints_a_table_or_json_and_plots(plane: Solution, tmp_path: Path) -> None:
    file, plot = plane.save(tmp_path / "plane.npz"), tmp_path / "push.png"
    words = ("push", file, "--controller", "joints", "--time", 0.2, "--accuracy", 1)
    done = invoke(*words, "--output", plot)
    assert done.exit_code == 0, done.stderr
    assert done.stdout.splitlines()[2].startswith("0 forward")
    assert plot.stat().st_size > 1000
    figures = json.loads(invoke(*words, "--json").stdout)
    assert figures["directions"] == [0.0, 180.0]
    assert figures["robot"] == "hopper"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--output", "x.txt"), "its ending is '.txt'; allowed: .png, .svg, .pdf"),
        (("--output", "/no/such/folder/x.png"), "cannot write"),
        (("--controller", "arms"), "--controller"),
        (("--directions", "0"), "directions of largest_pushes is 0"),
        (("--time", "9"), "a push at 9 s is outside of the motion"),
        (("--time", "-1"), "time of largest_pushes is -1"),
    ],
)
def test_wrong_options_are_one_line(
    words: tuple[str, ...], message: str, stand: Solution, tmp_path: Path
) -> None:
    assert_refused(invoke("push", stand.save(tmp_path / "stand.npz"), *words), message)
