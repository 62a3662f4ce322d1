"""Goals at the start or out of reach, far places."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.changed_robots import limited, solo, ur5
from tests.extremes.moves import legged, reach, stance, with_joints
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt import FlatGround, Phase, Problem, Robot, Schedule, Solution, middle_of, terms
from trajopt.robot import frame_pose
from trajopt.schedule import footholds_at
from trajopt.solvers.status import Status
from trajopt_library import robots

pytestmark = pytest.mark.long

# Open-loop error (rad) of an arm's second of motion on ten intervals of degree two; measured up to 2e-2.
ARM = 5e-2
# Of a stance of 0.4 s, over the robot's length or rad; measured up to 2e-4.
STANCE = 2e-3
# Of a hop, ten intervals in all; feet creep with it.
HOP, CREEP = 0.2, 5e-3
# A motion 1e4 m from the origin has positions to 1e4 times the rounding of one, 2e-12 m; its optimum is flat.
FAR, FAR_MOTION = 1e4, 1e-9
# Of a motion 1e4 m up, where iterates differ a little: what solvers leave at a tolerance of 1e-6.
MOUNTAIN = 1e-4


# The goal is the start


def test_an_arm_whose_goal_is_its_start_ends_there():
    solution = assert_outcome(Solved(ARM), lambda: reach(ur5(), ur5().reference, ur5().reference))
    assert solution.statistics.iterations <= 10
    assert_allclose(solution.q[-1], ur5().reference, atol=1e-6)


def test_a_hanging_pendulum_whose_goal_is_its_start_costs_nothing():
    """Where rest needs no torque the optimum is nothing at all: no motion, no effort, no 0 / 0."""
    pendulum, hanging = robots.load("double_pendulum"), robots.load("double_pendulum").reference
    still = np.zeros(pendulum.nv)
    torque = pin.rnea(pendulum.model, pendulum.model.createData(), hanging, still, still)
    assert_allclose(torque, 0.0, atol=1e-5)  # rounding of its description
    solution = assert_outcome(Solved(ARM), lambda: reach(pendulum, hanging, hanging))
    assert solution.statistics.objective < 1e-9
    assert np.abs(solution.v).max() < 1e-4


@pytest.mark.parametrize("name", ["solo12", "hopper"])
def test_a_robot_on_legs_whose_goal_is_its_start_stays(name):
    robot = robots.load(name)
    duration = 0.4 if name == "solo12" else 0.1
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, robot.reference, duration=duration))
    assert solution.statistics.iterations <= 15
    assert np.abs(np.diff(solution.q[:, 0])).max() < 0.01


# Goals that cannot be met


def at(place: list[float]) -> Callable[[], Problem]:
    end = (terms.FramePose(frame="tool0", position=np.array(place)), terms.TerminalRest(q=ur5().reference))
    return lambda: reach(ur5(), ur5().reference, ur5().reference, end=end)


@pytest.mark.parametrize("place", [[1.5, 0.0, 0.3], [0.0, -1.4, 0.1], [0.0, 0.0, 1e6]])
def test_a_goal_beyond_all_links_of_an_arm_is_refused(place):
    assert_outcome(
        Refused(r"'tool0' and the place where its first joint is fixed .* apart; allowed: up to 1\.24 m"),
        at(place),
    )


@pytest.mark.parametrize("place", [[0.0, 0.0, 1.2], [1.05, 0.0, 0.1]])
def test_a_goal_that_only_postures_put_out_of_reach_names_its_rows(place):
    assert_outcome(Failed(Status.INFEASIBLE, block="frame_pose"), at(place))


def test_a_goal_beyond_the_limits_is_refused():
    goal = with_joints(ur5(), {"elbow_joint": 4.0})
    refused = Refused("terminal_state joint 'elbow_joint' is at 4, beyond its position_limits; allowed: -3")
    assert_outcome(refused, lambda: reach(ur5(), ur5().reference, goal))


def test_a_goal_too_far_for_the_rates_names_it():
    goal = ur5().reference - 2.0
    failed = Failed(Status.INFEASIBLE, Status.ITERATION_LIMIT, Status.STEP_FAILED)
    assert_outcome(failed, lambda: reach(ur5(), ur5().reference, goal, duration=0.2), max_iterations=200)


def test_a_goal_that_feet_contradict_is_refused():
    """It would be asked for only in the directions that feet leave free: that is, not at all."""
    goal = solo().reference.copy()
    goal[0] += 0.05
    assert_outcome(
        Refused("'FL_FOOT' 0.05 m from where it stands in phase 'stance'"),
        lambda: stance(solo(), solo().reference, goal),
    )


def test_a_jump_too_high_for_its_torques_is_not_solved():
    """Half the torque that standing takes lifts nobody: the height's row and the torques' are named."""
    failed = Failed(Status.INFEASIBLE, Status.ITERATION_LIMIT)
    weak = limited(0.3)
    assert_outcome(failed, lambda: hop(weak, rise=0.5), intervals=8, max_iterations=40)


def hop(robot: Robot, *, away: tuple[float, float, float] = (0.0, 0.0, 0.0), rise: float = 0.0) -> Problem:
    """Stance, flight, landing 0.1 m ahead; ``away`` (3,) m from the origin."""
    start, ground = robot.reference.copy(), FlatGround(friction=0.7, height=away[2])
    start[:3] += away
    goal = start.copy()
    goal[0] += 0.1
    feet = footholds_at(robot, goal)
    schedule = Schedule(
        (
            Phase(name="stance", duration=0.3, contacts=tuple(feet)),
            Phase(name="flight", duration=0.2),
            Phase(name="landing", duration=0.3, contacts=tuple(feet), footholds=feet),
        )
    )

    def guess(t: float) -> np.ndarray:
        q = start.copy()
        q[0] += 0.1 * float(np.clip((t - 0.3) / 0.2, 0.0, 1.0))
        q[2] += max(0.0, 9.81 * (t - 0.3) * (0.5 - t) / 2)
        return q

    high = terms.FrameHeight(frame="base_link", height=start[2] + rise, at=middle_of("flight"))
    over = terms.SwingClearance(height=0.02, terrain=ground)
    extra = (over, *((high,) if rise else ()))
    return legged(robot, schedule, start, goal, guess, extra=extra, ground=ground)


# Far from the origin


def test_a_hop_far_from_the_origin_is_the_same_hop_there():
    coarse = Solved(HOP, coarse=CREEP)
    robot = limited(2.7)
    here = assert_outcome(coarse, lambda: hop(robot), intervals=10)
    away = (-FAR, FAR, 0.0)
    there = assert_outcome(coarse, lambda: hop(robot, away=away), intervals=10)
    assert there.statistics.iterations == here.statistics.iterations
    assert there.statistics.objective == pytest.approx(here.statistics.objective, rel=1e-9)
    moved = there.q.copy()
    moved[:, :3] -= away
    assert_allclose(moved, here.q, atol=FAR_MOTION)
    assert_allclose(there.tau, here.tau, atol=FAR_MOTION * robot.weight)


@pytest.mark.slow
def test_a_hop_on_a_mountain_is_the_same_hop():
    """Heights over the ground are bounded relative to it: solvers relax a bound in proportion to its size."""
    robot, coarse = limited(2.7), Solved(HOP, coarse=CREEP)
    here = assert_outcome(coarse, lambda: hop(robot), intervals=10)
    there = assert_outcome(coarse, lambda: hop(robot, away=(0.0, 0.0, FAR)), intervals=10)
    moved = there.q.copy()
    moved[:, 2] -= FAR
    assert_allclose(moved, here.q, atol=MOUNTAIN)


def test_a_far_goal_is_measured_from_where_the_arm_stands():
    """An arm on a tower of 1e4 m reaches what it reaches on the ground."""
    arm, up = ur5(), np.array([0.0, 0.0, FAR])
    model = arm.model.copy()
    placement = model.jointPlacements[1].copy()
    placement.translation = placement.translation + up
    model.jointPlacements[1] = placement
    tower = replace(arm, model=model)
    goal = frame_pose(arm, with_joints(arm, {"elbow_joint": 1.2}), "tool0").translation
    ends = [
        (terms.FramePose(frame="tool0", position=p), terms.TerminalRest(q=arm.reference))
        for p in (goal, goal + up)
    ]
    limits = (terms.TorqueLimits(), terms.PositionLimits(), terms.VelocityLimits())
    here, there = (
        assert_outcome(
            Solved(ARM), partial(reach, robot, arm.reference, arm.reference, end=end, limits=limits)
        )
        for robot, end in zip((arm, tower), ends, strict=True)
    )
    assert_same_motion(here, there)


def assert_same_motion(here: Solution, there: Solution) -> None:
    assert there.statistics.objective == pytest.approx(here.statistics.objective, rel=1e-6)
    assert_allclose(there.q, here.q, atol=1e-5)
