"""Plans of finite motions that are replanned from the measured state, in MuJoCo."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_lines import assert_refused, invoke
from tests.support.solved_problems import motion
from trajopt import Solution, load, simulate, solve
from trajopt.control.mpc.clock import Mode
from trajopt.control.mpc.replanning import PlanClock, ReplanningController
from trajopt.errors import InputError
from trajopt.motion.samples import contact_places
from trajopt.problem.problem import Problem
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation import Impulse
from trajopt_library import robots

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def problem() -> Problem:
    return load("solo12-jump")


@pytest.fixture(scope="module")
def jump() -> Solution:
    return motion("solo12-jump")


def test_the_clock_of_a_plan_ends_with_its_last_contacts_without_end() -> None:
    clock = PlanClock(("a", "b"), [Mode(("a", "b"), 0.4), Mode((), 0.3), Mode(("a",), 0.5)], 0.4)
    assert [mode.contacts for mode in clock.horizon(0.2)] == [("a", "b")]
    clock.advance(0.25, {"a": True, "b": True})
    assert clock.time == pytest.approx(0.25)
    assert [mode.contacts for mode in clock.horizon(0.2)] == [("a", "b"), ()]
    clock.advance(0.15, {"a": True, "b": True})
    flight, landed = clock.horizon(0.5)
    assert (flight.contacts, landed.contacts) == ((), ("a",))
    assert (flight.duration, landed.duration) == pytest.approx((0.3, 0.5))
    clock.advance(0.15, {"a": False, "b": False})
    assert clock.time == pytest.approx(0.55)
    clock.advance(0.1, {"a": True, "b": False})  # early: the next mode begins, and is longer
    assert clock.horizon(0.5)[0].contacts == ("a",)
    assert clock.time == pytest.approx(0.65)
    clock.advance(0.55, {"a": True, "b": False})
    assert math.isinf(clock.remaining)
    assert clock.time == pytest.approx(1.2)
    assert [mode.contacts for mode in clock.horizon(0.4)] == [("a",)]
    clock.advance(9.0, {"a": True, "b": False})
    assert clock.time == pytest.approx(1.2)


def test_a_jump_is_followed_and_survives_a_push_that_its_tracker_does_not(
    problem: Problem, jump: Solution
) -> None:
    alone = simulate(jump, controller=ReplanningController(problem.robot, jump)).report
    assert alone.passed
    assert alone.base_error_end < 5e-3
    robot = problem.robot
    units = NaturalUnits.of(robot.model)
    size, lasts = 0.3 * units.weight * units.time, 0.1 * units.time
    push = Impulse(direction=0.0, size=size, time=0.36, duration=lasts)
    tracked = simulate(jump, controller="whole-body", impulse=push).report
    planned = simulate(jump, controller=ReplanningController(robot, jump), impulse=push).report
    assert tracked.fell
    assert planned.passed


def test_ground_of_other_heights_is_planned_for() -> None:
    """Onto a box: feet land on its top."""
    problem = load("quadruped-box-up", robot="go2")
    plan = solve(problem)
    controller = ReplanningController(problem.robot, plan)
    report = simulate(plan, controller=controller).report
    assert report.passed
    assert controller.report.anew == 0
    last = controller._reference_at(controller.clock, problem.robot.reference)
    foot = contact_places(plan).position[-1, 0, 2]
    assert foot > 2 * problem.robot.contacts[0].radius
    assert last.landing_height(problem.robot.contacts[0].name, 0.0) == pytest.approx(foot, abs=1e-4)


def test_horizons_are_made_before_the_first_tick(problem: Problem, jump: Solution) -> None:
    controller = ReplanningController(problem.robot, jump)
    made = len(controller.planner.horizons)
    simulate(jump, controller=controller, mass_scale=1.2)
    assert len(controller.planner.horizons) == made


def test_what_cannot_be_planned_anew_is_one_line(problem: Problem, jump: Solution) -> None:
    with pytest.raises(InputError, match="plan of 'solo12' has other joints, contacts or another mass"):
        ReplanningController(robots.load("go2"), jump)
    with pytest.raises(InputError, match="has a fixed base"):
        ReplanningController(robots.load("ur5"), jump)
    controller = ReplanningController(problem.robot, jump)
    standing = np.ones(4, dtype=bool)
    with pytest.raises(InputError, match="contacts have shape"):
        controller.torque(0.0, jump.q[0], jump.v[0], np.ones(9, dtype=bool)[:3])
    with pytest.raises(InputError, match="q\\[3\\] of a state is nan"):
        controller.torque(0.0, np.where(np.arange(19) == 3, np.nan, jump.q[0]), jump.v[0], standing)


def test_the_command_simulates_a_file_by_plans_made_anew(jump: Solution, tmp_path: Path) -> None:
    path = jump.save(tmp_path / "jump.npz")
    again = "simulate", path, "--controller", "receding-horizon"
    done = invoke(*again, "--mass-scale", 1.2)
    assert done.exit_code == 0, done.stderr
    assert "tracked" in done.stdout
    assert_refused(invoke(*again, "--kp", 2), "--kp has no effect here")
    arm = motion("ur5-reach").save(tmp_path / "reach.npz")
    assert_refused(invoke("simulate", arm, *again[2:]), "robot 'ur5' has a fixed base")
