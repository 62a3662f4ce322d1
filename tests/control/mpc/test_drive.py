"""Drives in lockstep: a robot that walks as commanded, pushes, ground it does not know, falls, bad input."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajopt import Robot, Solution
from trajopt.control.mpc.commands import Command, CommandScript
from trajopt.control.mpc.controller import Controller
from trajopt.control.mpc.hidden_ground import DISTANCE, boxes_ahead, slope_ahead
from trajopt.control.mpc.payload import carrying, payload_numbers
from trajopt.control.mpc.planner import PlannerSettings
from trajopt.control.mpc.receding import ControllerSettings
from trajopt.errors import InputError
from trajopt.simulation.drive_report import command_errors
from trajopt.simulation.lockstep import DrivenMotion, drive
from trajopt.simulation.rise import RISE_TIME
from trajopt.simulation.settings import Impulse
from trajopt.terrain import PiecewiseTerrain
from trajopt_library import robots

pytestmark = pytest.mark.long

# Walking straight, and then in a curve of more than the angle at which a base has turned over.
SPEED, TURN = 0.4, 1.2
STRAIGHT = Command(gait="trot", speed=SPEED)
SCRIPT = CommandScript((0.0, 0.2), (Command(), Command(gait="trot", speed=SPEED, turn_rate=TURN)))
TROT = CommandScript((0.0, 0.2), (Command(), STRAIGHT))
# Means of speeds over a period are this near to commands, m/s or rad/s: a fifth of them.
NEAR = 0.2 * SPEED
# Height of the base of a robot that lies over that of one that stands, and the error of the latter.
LIES, HEIGHT_ERROR = 0.35, 0.03
# A foot on the ground is this near to it, m: it gives way.
GIVES_WAY = 2e-3


@pytest.fixture(scope="module")
def go2() -> Robot:
    return robots.load("go2")


@pytest.fixture(scope="module")
def walk(go2: Robot) -> DrivenMotion:
    return drive(go2, SCRIPT, duration=2.0)


def test_a_robot_moves_as_commanded_and_does_not_fall(walk: DrivenMotion) -> None:
    report = walk.report
    assert report.passed
    assert report.simulated == pytest.approx(2.0)
    assert report.mean_errors is not None
    assert report.mean_errors.speed < NEAR
    assert report.mean_errors.lateral < NEAR
    assert report.mean_errors.turn_rate < 0.2 * TURN
    assert report.distance == pytest.approx(SPEED * 1.8, rel=0.3)
    heading = 2 * math.atan2(walk.record.qpos[-1, 6], walk.record.qpos[-1, 3])
    assert heading > math.pi / 3


def test_a_drive_is_the_same_each_time_bit_by_bit_with_a_controller_of_ones_own_too(
    walk: DrivenMotion, go2: Robot
) -> None:
    again = drive(go2, SCRIPT, duration=0.6, controller=Controller(go2))
    for name in ("qpos", "qvel", "torque", "force"):
        first, second = getattr(walk.record, name), getattr(again.record, name)
        np.testing.assert_array_equal(first[:600], second[:600])
    with pytest.raises(InputError, match="controller of drive has gaits and settings"):
        drive(go2, SCRIPT, controller=Controller(go2), gaits=("trot",))
    with pytest.raises(InputError, match="of a robot with other joints or contacts"):
        drive(robots.load("anymal_c"), SCRIPT, controller=Controller(go2))
    with pytest.raises(InputError, match="of a robot with other joints or contacts"):
        drive(replace(go2, contacts=go2.contacts[::-1]), SCRIPT, controller=Controller(go2))


def test_a_robot_that_carries_what_its_controller_knows_of_keeps_its_height(go2: Robot) -> None:
    """A third of its weight on the base: it sags by half of what it does when nobody says so, or less."""
    mass, place = 0.3 * go2.weight / 9.81, [0.03, 0.03, 0.1]
    loaded = replace(go2, model=carrying(go2.model, payload_numbers(mass, place)))
    heights = []
    for told, robot in ((False, go2), (False, loaded), (True, loaded)):
        controller = Controller(go2)
        if told:
            controller.carry(mass, place)
        run = drive(robot, TROT, duration=1.6, controller=controller)
        assert run.report.passed
        heights.append(float(run.record.qpos[800:, 2].mean()))
    usual, untold, told_height = heights
    assert usual - untold > 1e-3
    assert abs(usual - told_height) < 0.5 * (usual - untold)


def test_durations_that_are_free_change_with_a_push(go2: Robot) -> None:
    """A push makes feet land at other times; without one a trot is as the gait says."""
    settings = ControllerSettings(planner=PlannerSettings(timing=0.0))
    push = Impulse(direction=math.pi / 2, size=14.0, time=0.9, duration=0.02)
    passed = []
    for given, pushes in ((settings, ()), (None, ()), (None, (push,))):
        run = drive(go2, TROT, duration=1.6, settings=given, pushes=pushes)
        assert run.report.passed
        clock = run.controller.clock
        passed.append(clock.number + 1 - clock.remaining / clock.whole)
    fixed, steady, pushed = passed
    assert steady == pytest.approx(fixed, abs=0.3)
    assert abs(pushed - steady) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heights", "run"), [((0.05, 0.1, 0.05, 0.0), 0.3), ((0.1, 0.0), 0.6)], ids=["stairs", "step"]
)
def test_a_robot_trots_up_and_down_ground_that_its_controller_knows(
    heights: tuple[float, ...], run: float, go2: Robot
) -> None:
    """Stairs and a step of a third of its legs: it keeps its speed, rises by the height, and ends behind."""
    terrain = PiecewiseTerrain.steps(heights, run, at=(DISTANCE, 0.0))
    far = DISTANCE + run * (len(heights) - 1) + 0.4
    driven = drive(go2, TROT, duration=0.2 + far / SPEED, terrain=terrain)
    report, base = driven.report, driven.record.qpos
    assert report.passed
    assert report.mean_errors is not None
    assert report.mean_errors.speed < 0.25 * NEAR
    assert base[-1, 0] > far - 0.2
    assert base[-1, 2] == pytest.approx(base[0, 2], abs=0.02)
    rise = np.interp(DISTANCE + run, base[:, 0], base[:, 2]) - base[0, 2]
    assert rise == pytest.approx(np.mean(heights[:2]), abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["go2", "solo12"])
def test_a_robot_that_lies_stands_up_without_a_jump_and_follows_its_commands(name: str) -> None:
    robot = robots.load(name)
    driven = drive(robot, TROT, lying=True)
    rises, report, height = RISE_TIME * driven.scene.units.time, driven.report, driven.record.qpos[:, 2]
    stood, standing = round(rises / driven.timeline.period), robot.reference[2]
    assert driven.script.times == pytest.approx((0.0, rises, rises + 0.2))
    assert report.passed
    assert report.begun_anew == 0
    assert report.mean_errors is not None
    assert report.mean_errors.speed < 0.25 * NEAR
    assert height[0] < LIES * standing
    assert driven.record.touched[: stood // 10].any()
    assert not driven.record.touched[stood // 2 :].any()
    assert height[stood:] == pytest.approx(standing, rel=HEIGHT_ERROR)
    assert height.max() < (1 + HEIGHT_ERROR) * standing
    joints = driven.scene.coordinates.from_mujoco(driven.record.qpos)[:, 7:]
    assert (joints > robot.position_lower[7:]).all()
    assert (joints < robot.position_upper[7:]).all()


def test_a_robot_that_is_thrown_over_while_it_rises_has_fallen(go2: Robot) -> None:
    thrown = Impulse(direction=math.pi / 2, size=200.0, time=0.5, duration=0.1)
    driven = drive(go2, TROT, lying=True, pushes=[thrown])
    assert driven.report.fall_time == pytest.approx(RISE_TIME * driven.scene.units.time, abs=0.01)


def test_speeds_are_those_of_the_base(walk: DrivenMotion) -> None:
    q, period = walk.record.qpos, walk.timeline.period
    assert walk.velocity.shape == walk.commanded.shape == (2000, 3)
    moved = np.linalg.norm(np.diff(q[:, :2], axis=0), axis=1) / period
    np.testing.assert_allclose(np.linalg.norm(walk.velocity[:, :2], axis=1), moved, atol=NEAR)
    np.testing.assert_array_equal(walk.commanded[:200], 0.0)
    np.testing.assert_array_equal(walk.commanded[200:], [[SPEED, 0.0, TURN]] * 1800)


def test_the_report_is_json_with_the_commands(walk: DrivenMotion) -> None:
    figures = json.loads(json.dumps(walk.report.to_dict()))
    assert figures["passed"] is True
    assert figures["plans"] == 200
    assert sum(figures["relaxed"].values()) == 2000
    assert figures["script"]["times"] == [0.0, 0.2]
    assert figures["script"]["commands"][1]["turn_rate"] == TURN
    assert set(figures["plan_times"]) == {"mean", "median", "p95", "p99"}
    assert walk.report.table().endswith("it did not fall")


def test_the_motion_is_a_solution(walk: DrivenMotion, tmp_path: Path) -> None:
    found = Solution.load(walk.as_solution().save(tmp_path / "run.npz"))
    assert found.success
    assert found.statistics.simulated
    assert found.description.problem == "drive"
    assert found.t[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(found.q[-1, :3], walk.record.qpos[-1, :3], atol=1e-12)
    assert found.statistics.simulation == walk.report.to_dict()
    stands = found.active.mean(axis=0)
    assert (stands > 0.5).all()
    assert (stands < 0.9).all()


def test_a_push_moves_the_base_to_its_side(walk: DrivenMotion, go2: Robot) -> None:
    size, time = 8.0, 0.1
    push = Impulse(direction=math.pi / 2, size=size, time=time, duration=0.02)
    pushed = drive(go2, SCRIPT, duration=0.4, pushes=[push])
    assert pushed.report.passed
    np.testing.assert_array_equal(pushed.record.qpos[:100], walk.record.qpos[:100])
    gained = pushed.velocity[100:130, 1].max()
    assert 0.1 < gained * go2.weight / 9.81 / size < 1.5


def test_a_robot_that_falls_ends_its_drive(go2: Robot) -> None:
    push = Impulse(direction=math.pi / 2, size=100.0, time=0.1, duration=0.02)
    found = drive(go2, SCRIPT, duration=2.0, pushes=[push])
    assert found.report.fell
    assert found.report.fall_time is not None
    assert 0.1 < found.report.fall_time <= found.report.simulated < 2.0
    assert len(found.record.torque) == len(found.record.qpos) - 1
    assert found.report.table().splitlines()[-1].startswith("it fell at ")
    assert not found.as_solution().success


def test_feet_stand_on_a_slope_of_which_the_controller_knows_nothing(go2: Robot) -> None:
    slope, script = slope_ahead(5.0), CommandScript((0.0, 0.1), (Command(), STRAIGHT))
    found = drive(go2, script, duration=1.6, ground=slope)
    assert found.report.passed
    loaded = np.linalg.norm(found.record.force[:, :, :3], axis=2) > 0.1 * go2.weight
    feet = found.record.feet[loaded]
    surfaces = slope.offset(found.scene.place.radii[0])
    on_slope = feet[:, 0] > DISTANCE + 0.05
    assert on_slope.any()
    np.testing.assert_allclose(feet[:, 2], surfaces.height(feet[:, 0], feet[:, 1]), atol=GIVES_WAY)
    assert found.as_solution().description.terrain is slope


def test_a_slope_begins_in_front_of_the_robot() -> None:
    slope = slope_ahead(-10.0)
    x = np.array([-5.0, 0.0, DISTANCE, DISTANCE + 1.0, DISTANCE + 10.0])
    heights = [0.0, 0.0, 0.0, *(-math.tan(math.radians(10)) * np.array([1.0, 10.0]))]
    np.testing.assert_allclose(slope.height(x, np.zeros(5)), heights, atol=1e-12)


def test_boxes_are_those_of_their_seed_and_as_high_as_asked_for(go2: Robot) -> None:
    x, y = np.meshgrid(np.linspace(-2.0, 8.0, 501), np.linspace(-2.0, 2.0, 201))
    first, again, other = (boxes_ahead(go2, 0.2, seed).height(x, y) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01
    assert not first[x < DISTANCE].any()
    assert first.min() == 0.0
    assert 0.15 * go2.length < first.max() <= 0.2 * go2.length
    assert first[x > DISTANCE + 2.9].max() > 0.1 * go2.length


def test_swings_about_a_command_are_no_error_of_the_mean() -> None:
    period, gait = 0.01, 0.4
    script = CommandScript((0.0, 1.0, 3.0), (Command(), STRAIGHT, Command()))
    t = period * np.arange(400)
    swings = 0.3 * np.sin(2 * np.pi * t / gait)
    velocity = np.column_stack([SPEED + 0.1 + swings, swings, 0.0 * t])
    velocity[t >= 3.0] = velocity[t < 1.0] = 9.0  # of a robot that stands nothing counts
    means, values = command_errors(script, velocity, period, {"trot": gait})
    assert means is not None
    assert values is not None
    assert means.speed == pytest.approx(0.1)
    assert means.lateral == pytest.approx(0.0, abs=1e-9)
    assert values.lateral == pytest.approx(0.3 / math.sqrt(2), rel=0.05)
    assert command_errors(CommandScript((0.0,), (Command(),)), velocity, period, {"trot": gait})[0] is None


@pytest.mark.parametrize(
    ("name", "settings", "line"),
    [
        ("ur5", {}, "robot 'ur5' has a fixed base; allowed: a free base, on feet"),
        ("hopper", {}, "robot 'hopper' has a planar base; allowed: a free base, on feet"),
        ("g1", {"lying": True}, "robot 'g1' cannot lie; allowed: a quadruped on point feet"),
        ("hyq", {"lying": True}, "'hyq' cannot lie; allowed: "),
        ("go2", {"duration": 0.0}, "duration of drive is 0.0; allowed: "),
        ("go2", {"kp": 2.0}, "a drive has no setting 'kp'; allowed: timestep, control_rate"),
        ("go2", {"gaits": ["trot", "moonwalk"]}, "gait 'moonwalk' is unknown"),
        (
            "go2",
            {"gaits": ["pace"]},
            "gait 'trot' of the script is not among those of the drive; allowed: pace",
        ),
        (
            "go2",
            {"ground": PiecewiseTerrain.stairs(0.1, 0.3, 2)},
            "not at the height 0 where the robot stands",
        ),
        ("go2", {"friction_scale": -1.0}, "friction_scale of SimulationSettings is -1.0"),
        ("go2", {"settings": ControllerSettings(live=True)}, "settings of drive are live"),
        ("go2", {"duration": 1e4}, "a simulation of 1e+07 periods of its controller; allowed: 200000"),
        (
            "go2",
            {"pushes": [Impulse(direction=0.0, size=1.0, time=9.0, duration=0.1)], "duration": 1.0},
            "an impulse at 9 s is after the simulation",
        ),
    ],
)
def test_what_cannot_be_driven_is_one_line(name: str, settings: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as refused:
        drive(robots.load(name), SCRIPT, **settings)
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("function", "value"), [(slope_ahead, 70.0), (slope_ahead, math.nan)])
def test_slopes_that_are_no_ground_are_refused(function: Any, value: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        function(value)
