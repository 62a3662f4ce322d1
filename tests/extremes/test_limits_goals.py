"""Starts on and beyond limits, goals at the start or out of reach, far places, numbers that are none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.moves import legged, reach, stance, with_joints
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import contact_positions, frame_pose
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solution.solution import Solution
from trajopt.solvers.status import Status
from trajopt.solving.solving import prepare
from trajopt.terms import (
    EffortLimits,
    FrameHeight,
    FramePose,
    FrameVelocity,
    FrictionCone,
    PositionLimits,
    PostureCost,
    SwingClearance,
    TerminalRest,
    TerminalState,
    TorqueCost,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface
from trajopt_library import problems, robots

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
# A start may exceed a limit by this part of it.
SLACK = 1e-6


def ur5() -> Robot:
    return robots.load("ur5")


def solo() -> Robot:
    return robots.load("solo12")


# Limits


def test_a_joint_starts_exactly_on_its_limit():
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2])})
    goal = with_joints(ur5(), {"elbow_joint": 2.0})
    solution = assert_outcome(Solved(ARM), lambda: reach(ur5(), start, goal))
    assert solution.q[:, 2].max() <= ur5().position_upper[2] * (1 + SLACK)


@pytest.mark.parametrize("beyond", [1e-4, 0.2, 5.0])
def test_a_joint_that_starts_beyond_its_limit_is_refused(beyond):
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2]) + beyond})
    assert_outcome(
        Refused(r"joint 'elbow_joint' is at 3\.1\d+|joint 'elbow_joint' is at [38]\.\d+, beyond"),
        lambda: reach(ur5(), start, ur5().reference),
    )


def test_a_joint_beyond_a_limit_too_wide_for_rows_is_refused():
    """A limit a turn from the reference makes no rows, and is a limit all the same."""
    start = with_joints(ur5(), {"shoulder_pan_joint": 7.0})
    assert_outcome(
        Refused("joint 'shoulder_pan_joint' is at 7, beyond"), lambda: reach(ur5(), start, ur5().reference)
    )


def test_a_start_beyond_a_limit_that_nothing_states_is_free():
    start = with_joints(ur5(), {"elbow_joint": float(ur5().position_upper[2]) + 0.2})
    make = lambda: reach(ur5(), start, ur5().reference, limits=(EffortLimits(),))  # noqa: E731
    solution = assert_outcome(None, make)
    assert solution.success


@pytest.mark.parametrize("part", [1.0, -1.0])
def test_a_joint_starts_at_its_largest_rate(part):
    velocity = np.zeros(6)
    velocity[0] = part * ur5().velocity_limit[0]
    goal = ur5().reference + np.array([part * 0.5, 0.1, 0.1, 0.1, 0.1, 0.1])
    assert_outcome(Solved(ARM), lambda: reach(ur5(), ur5().reference, goal, velocity=velocity))


@pytest.mark.parametrize("part", [1.001, -1.5])
def test_a_joint_that_starts_faster_than_its_limit_is_refused(part):
    velocity = np.zeros(6)
    velocity[0] = part * ur5().velocity_limit[0]
    make = lambda: reach(ur5(), ur5().reference, ur5().reference, velocity=velocity)  # noqa: E731
    assert_outcome(
        Refused("joint 'shoulder_pan_joint' moves at .* velocity_limits; allowed: -3.15 to 3.15"), make
    )


def test_all_joints_of_a_quadruped_stand_exactly_on_both_limits():
    """No joint may move at all: a feasible set without an inside, on which to stand still."""
    q = solo().reference
    lower, upper = solo().position_lower.copy(), solo().position_upper.copy()
    lower[7:], upper[7:] = q[7:], q[7:]
    robot = replace(solo(), position_lower=lower, position_upper=upper)
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, q, intervals=6))
    assert_allclose(solution.q[:, 7:], np.tile(q[7:], (len(solution.t), 1)), atol=1e-6)


def test_joints_whose_largest_rate_is_zero_stand_still():
    robot = replace(solo(), velocity_limit=np.where(np.isfinite(solo().velocity_limit), 0.0, np.inf))
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, robot.reference, intervals=6))
    assert np.abs(solution.v).max() < 1e-6


def largest_torque() -> float:
    """Of standing with least effort, N m."""
    solution = assert_outcome(Solved(STANCE), lambda: stance(solo(), solo().reference, intervals=4))
    return float(np.abs(solution.tau).max())


def limited(torque: float) -> Robot:
    return replace(solo(), effort_limit=np.full(12, torque))


def test_standing_at_the_torque_limit_is_solved_and_at_half_of_it_not():
    need = largest_torque()
    at = assert_outcome(Solved(STANCE), lambda: stance(limited(need), solo().reference, intervals=4))
    assert np.abs(at.tau[at.collocation]).max() <= need * (1 + 10 * SLACK)
    weak = Failed(Status.INFEASIBLE, block="effort_limits")
    assert_outcome(weak, lambda: stance(limited(need / 2), solo().reference, intervals=4))
    assert_outcome(weak, lambda: stance(limited(0.0), solo().reference, intervals=4))


# The goal is the start


def test_an_arm_whose_goal_is_its_start_ends_there():
    solution = assert_outcome(Solved(ARM), lambda: reach(ur5(), ur5().reference, ur5().reference))
    assert solution.meta["iterations"] <= 10
    assert_allclose(solution.q[-1], ur5().reference, atol=1e-6)


def test_a_hanging_pendulum_whose_goal_is_its_start_costs_nothing():
    """Where rest needs no torque the optimum is nothing at all: no motion, no effort, no 0 / 0."""
    pendulum, hanging = robots.load("double_pendulum"), robots.load("double_pendulum").reference
    still = np.zeros(pendulum.nv)
    torque = pin.rnea(pendulum.model, pendulum.model.createData(), hanging, still, still)
    assert_allclose(torque, 0.0, atol=1e-5)  # rounding of its description
    solution = assert_outcome(Solved(ARM), lambda: reach(pendulum, hanging, hanging))
    assert solution.meta["objective"] < 1e-9
    assert np.abs(solution.v).max() < 1e-4


@pytest.mark.parametrize("name", ["solo12", "hopper"])
def test_a_robot_on_legs_whose_goal_is_its_start_stays(name):
    robot = robots.load(name)
    duration = 0.4 if name == "solo12" else 0.1
    solution = assert_outcome(Solved(STANCE), lambda: stance(robot, robot.reference, duration=duration))
    assert solution.meta["iterations"] <= 15
    assert np.abs(np.diff(solution.q[:, 0])).max() < 0.01


# Goals that cannot be met


def at(place: list[float]) -> Callable[[], Problem]:
    end = (FramePose(frame="tool0", position=np.array(place)), TerminalRest(q=ur5().reference))
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


def test_a_goal_beyond_the_limits_names_its_rows():
    goal = with_joints(ur5(), {"elbow_joint": 4.0})
    failed = Failed(Status.INFEASIBLE, block="terminal_state")
    assert_outcome(failed, lambda: reach(ur5(), ur5().reference, goal))


def test_a_goal_too_far_for_the_rates_names_it():
    goal = ur5().reference + 2.0
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
    feet = contact_positions(robot, goal)
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

    high = FrameHeight(frame="base_link", height=start[2] + rise, phase="flight")
    over = SwingClearance(height=0.02, terrain=ground)
    problem = legged(robot, schedule, start, goal, guess, extra=(over, *((high,) if rise else ())))
    return replace(problem, terrain=ground)


# Far from the origin


@pytest.mark.parametrize("solver", ["ipopt", pytest.param("fatrop", marks=pytest.mark.slow)])
def test_a_hop_far_from_the_origin_is_the_same_hop_there(solver):
    coarse = Solved(HOP, coarse=CREEP)
    robot = limited(2.7)
    here = assert_outcome(coarse, lambda: hop(robot), solver=solver, intervals=10)
    away = (-FAR, FAR, 0.0)
    there = assert_outcome(coarse, lambda: hop(robot, away=away), solver=solver, intervals=10)
    assert there.meta["iterations"] == here.meta["iterations"]
    assert there.meta["objective"] == pytest.approx(here.meta["objective"], rel=1e-9)
    moved = there.q.copy()
    moved[:, :3] -= away
    assert_allclose(moved, here.q, atol=FAR_MOTION)
    assert_allclose(there.tau, here.tau, atol=FAR_MOTION * robot.weight)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_a_hop_on_a_mountain_is_the_same_hop(solver):
    """Heights over the ground are bounded relative to it: solvers relax a bound in proportion to its size."""
    robot, coarse = limited(2.7), Solved(HOP, coarse=CREEP)
    here = assert_outcome(coarse, lambda: hop(robot), solver=solver, intervals=10)
    there = assert_outcome(coarse, lambda: hop(robot, away=(0.0, 0.0, FAR)), solver=solver, intervals=10)
    moved = there.q.copy()
    moved[:, 2] -= FAR
    assert_allclose(moved, here.q, atol=MOUNTAIN)


# Numbers that are none


NAN, INF = float("nan"), float("inf")
Make = Callable[[float], object]


def arm_problem(**changes: object) -> Problem:
    return replace(reach(ur5(), ur5().reference, ur5().reference), **changes)


def ending(term: object) -> Problem:
    return arm_problem(terms=(TorqueCost(weight=1.0), term))


def spoiled(array: np.ndarray, value: float) -> np.ndarray:
    other = np.array(array, dtype=float)
    other.flat[-1] = value
    return other


Q = np.zeros(6)
HEIGHT = "frame's height"
PLACES: dict[str, tuple[str, Make]] = {
    "initial_q": ("initial_q .* not finite", lambda x: arm_problem(initial_q=spoiled(Q, x))),
    "initial_v": ("initial_v .* not finite", lambda x: arm_problem(initial_v=spoiled(Q, x))),
    "goal": ("q of terminal_state is not finite", lambda x: ending(TerminalState(q=spoiled(Q, x)))),
    "rest": (
        "terminal_rest in phase 'reach': q is not finite",
        lambda x: ending(TerminalRest(q=spoiled(Q, x))),
    ),
    "frame": ("position of frame_pose", lambda x: ending(FramePose(frame="tool0", position=[0.3, 0.0, x]))),
    "frame's rotation": (
        "rotation of frame_pose",
        lambda x: ending(FramePose(frame="tool0", rotation=spoiled(np.eye(3), x))),
    ),
    "frame's velocity": (
        "frame_velocity in phase 'reach': row 5 is bounded",
        lambda x: ending(FrameVelocity(frame="tool0", velocity=spoiled(Q, x))),
    ),
    HEIGHT: (
        "frame_height in phase 'reach': row 0 is bounded",
        lambda x: ending(FrameHeight(frame="tool0", height=x, phase="reach")),
    ),
    "posture": ("posture_cost in phase 'reach'", lambda x: ending(PostureCost(weight=1.0, q=spoiled(Q, x)))),
    "weight": ("weight of torque_cost", lambda x: TorqueCost(weight=x)),
    "friction": ("friction of friction_cone", lambda x: FrictionCone(friction=x)),
    "ground's friction": ("friction coefficient", lambda x: FlatGround(friction=x)),
    "ground's height": ("ground height", lambda x: FlatGround(height=x)),
    "ground's normal": (
        "normal of (the ground|a surface)",
        lambda x: FlatGround(normal=np.array([0.0, 0.0, x])),
    ),
    "surface": ("normal of a surface", lambda x: Surface(point=np.zeros(3), normal=[0.0, x, 1.0])),
    "foothold": (
        "foothold of 'FL_FOOT'",
        lambda x: Phase(name="p", duration=1.0, contacts=("FL_FOOT",), footholds={"FL_FOOT": [0.0, x, 0.0]}),
    ),
    "duration": ("duration of phase", lambda x: Phase(name="p", duration=x)),
    "duration bounds": (
        "duration_bounds of phase",
        lambda x: Phase(name="p", duration=1.0, duration_bounds=(0.5, x)),
    ),
    "clearance": ("swing clearance", lambda x: SwingClearance(height=x, terrain=FlatGround())),
    "reference": ("reference of robot 'ur5'", lambda x: replace(ur5(), reference=spoiled(Q, x))),
}


def refused(cause: str, make: Callable[[], Problem]) -> None:
    """As `assert_outcome` with `Refused`, but in this process: nothing here is solved."""
    with pytest.raises(InputError, match=cause) as caught:
        prepare(make(), intervals=2, compile="none")
    assert caught.value.allowed
    assert "\n" not in str(caught.value)


# A frame that must be above -inf is not bound at all.
NONE = [(where, value) for where in PLACES for value in (NAN, INF, -INF) if (where, value) != (HEIGHT, -INF)]


@pytest.mark.parametrize(("where", "value"), NONE, ids=str)
def test_a_number_that_is_none_is_refused_where_it_is_given(where, value):
    """By the time it is built, or where its rows are; in one line that says what is allowed."""
    cause, make = PLACES[where]

    def build() -> Problem:
        made = make(value)
        return made if isinstance(made, Problem) else arm_problem()

    refused(cause, build)


@pytest.mark.parametrize("limit", [[NAN] * 6, [1.0] * 5 + [-1.0], [1.0] * 5])
def test_torque_limits_that_are_none_are_refused(limit):
    refused("effort_limits", lambda: ending(EffortLimits(limit=np.array(limit))))


# How a guess may be wrong after 0.5 s, and what is said of it.
GUESSES: dict[str, tuple[str, Callable[[np.ndarray], object]]] = {
    "nan": ("is not finite", lambda q: q * NAN),
    "inf": ("is not finite", lambda q: q + INF),
    "none": (r"is of shape \(\)", lambda q: None),
    "words": ("is not numeric", lambda q: ["up"] * len(q)),
    "short": (r"is of shape \(\d+,\)", lambda q: q[:-1]),
}


@pytest.mark.parametrize("how", GUESSES)
@pytest.mark.parametrize("name", ["ur5", "solo12"])
def test_a_guess_that_is_no_configuration_is_refused_with_its_time(name, how):
    robot = robots.load(name)
    cause, wrong = GUESSES[how]
    q = robot.reference
    problem = reach(robot, q, q) if name == "ur5" else stance(robot, q, duration=1.0)
    broken = replace(problem, guess=lambda t: q if t < 0.7 else wrong(q))
    refused(rf"guess of problem '\w+' at t = 0\.[789]\d* s {cause}", lambda: broken)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_a_quaternion_that_is_none_is_refused(quaternion):
    q = solo().reference.copy()
    q[3:7] = quaternion
    good = solo().reference
    unit = "quaternion .* not unit; allowed: norm 1"
    refused(f"initial_q .* {unit}", lambda: stance(solo(), q, good, guess=lambda t: good))
    refused(f"terminal_state .* {unit}", lambda: stance(solo(), good, q, guess=lambda t: good))
    refused(f"guess .* {unit}", lambda: stance(solo(), good, guess=lambda t: q))


def parameters() -> list[tuple[str, str]]:
    """Every numeric parameter of every family of the library."""
    return [
        (family.name, parameter.name)
        for family in problems.families().values()
        for parameter in family.parameters
        if isinstance(parameter.lower, float | int)
    ]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400"])
def test_no_parameter_of_any_problem_takes_a_number_that_is_none(value):
    for name, parameter in parameters():
        with pytest.raises(InputError, match=rf"parameter {parameter}\b.*; allowed: "):
            problems.load(name, **{parameter: value})


def test_a_far_goal_is_measured_from_where_the_arm_stands():
    """An arm on a tower of 1e4 m reaches what it reaches on the ground."""
    arm, up = ur5(), np.array([0.0, 0.0, FAR])
    model = arm.model.copy()
    placement = model.jointPlacements[1].copy()
    placement.translation = placement.translation + up
    model.jointPlacements[1] = placement
    tower = replace(arm, model=model)
    goal = frame_pose(arm, with_joints(arm, {"elbow_joint": 1.2}), "tool0").translation
    ends = [(FramePose(frame="tool0", position=p), TerminalRest(q=arm.reference)) for p in (goal, goal + up)]
    limits = (EffortLimits(), PositionLimits(), VelocityLimits())
    here, there = (
        assert_outcome(
            Solved(ARM), partial(reach, robot, arm.reference, arm.reference, end=end, limits=limits)
        )
        for robot, end in zip((arm, tower), ends, strict=True)
    )
    assert_same_motion(here, there)


def assert_same_motion(here: Solution, there: Solution) -> None:
    assert there.meta["objective"] == pytest.approx(here.meta["objective"], rel=1e-6)
    assert_allclose(there.q, here.q, atol=1e-5)
