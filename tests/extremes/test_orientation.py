"""Turns: through all orientations, several whole ones, signs of quaternions, half turns, gimbal lock."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.extremes.moves import reach
from tests.extremes.outcomes import Failed, Refused, Solved, assert_outcome
from trajopt import Phase, Problem, Robot, Schedule, Solution
from trajopt.dynamics import STANDARD_GRAVITY
from trajopt.reduced import with_virtual_base
from trajopt.solvers.status import Status
from trajopt.terms import (
    AccelerationCost,
    PostureCost,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
)
from trajopt_library import problems, robots

pytestmark = pytest.mark.long

# A turn about one axis is linear in exponential coordinates: exact up to what a solver leaves of rows.
EXACT = 1e-7
# A symmetric top that tumbles, thirty intervals of degree three: rad at the end, measured 2e-6.
TUMBLE = 2e-5
# Of a quadruped that turns with its legs held, over a second: measured up to 1e-3 with a goal, 1e-6 without.
FLIP = 5e-3
# Its axes are not quite principal ones: on its way around the axis wanders by this, rad, measured 0.05.
NUTATION = 0.2
# Iterates of a problem and of its mirror image under q -> -q are the same numbers.
ROUNDING = 1e-12

AXES = {"pitch": (0.0, -1.0, 0.0), "roll": (1.0, 0.0, 0.0), "yaw": (0.0, 0.0, 1.0)}


@lru_cache
def brick() -> Robot:
    """One free body, no joints: a box of 1 kg, square about its z axis."""
    model = pin.Model()
    model.name = "brick"
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.3), pin.SE3.Identity())
    return Robot.from_model(model, name="brick", reference=pin.neutral(model))


def thrown(robot: Robot, omega: np.ndarray, duration: float, terms: tuple = (), **changes: object) -> Problem:
    """Thrown up with angular velocity ``omega`` (3,) rad/s, joints as in the reference."""
    start = robot.reference.copy()
    start[2] += 1.0
    velocity = np.zeros(robot.nv)
    velocity[2], velocity[3:6] = STANDARD_GRAVITY * duration / 2, omega

    def guess(t: float) -> np.ndarray:
        q = start.copy()
        q[2] += STANDARD_GRAVITY * t * (duration - t) / 2
        q[3:7] = pin.Quaternion(pin.exp3(omega * t)).coeffs()
        return q

    return replace(
        Problem(
            name="thrown",
            robot=robot,
            schedule=Schedule((Phase(name="flight", duration=duration),)),
            initial_q=start,
            initial_v=velocity,
            terms=terms,
            guess=guess,
        ),
        **changes,
    )


def held_joints(
    robot: Robot, omega: np.ndarray, duration: float, goal: bool = True, **changes: object
) -> Problem:
    """Thrown, costs hold the joints; with a goal: all turns done, joints where they were."""
    costs = (
        TorqueCost(weight=1e-2),
        PostureCost(weight=100.0),
        VelocityCost(weight=10.0, joints_only=True),
        AccelerationCost(weight=1e-2, joints_only=True),
        TorqueLimits(),
        VelocityLimits(),
    )
    problem = thrown(robot, omega, duration)
    end = (TerminalState(q=problem.guess(duration)),) if goal else ()
    return replace(problem, terms=(*costs, *end), **changes)


def turned(solution: Solution) -> np.ndarray:
    """Angle (3,) in rad that the base turns by in all, body axes: the sum of the turns between samples."""
    steps = [
        pin.log3(pin.Quaternion(*a[[6, 3, 4, 5]]).matrix().T @ pin.Quaternion(*b[[6, 3, 4, 5]]).matrix())
        for a, b in zip(solution.q[:-1], solution.q[1:], strict=True)
    ]
    return np.sum(steps, axis=0)


@pytest.mark.parametrize("turns", [1, 10])
@pytest.mark.parametrize("axis", AXES)
def test_a_body_turns_whole_turns_exactly(axis, turns):
    omega = 2 * np.pi * turns * np.array(AXES[axis])
    solution = assert_outcome(Solved(EXACT), lambda: thrown(brick(), omega, 1.0), intervals=3 * turns)
    assert_allclose(turned(solution), omega, atol=EXACT)


def test_a_tumbling_top_follows_its_closed_form_through_all_orientations():
    """R = exp(L t / I1) exp(lambda t e3), lambda = w3 (1 - I3 / I1) (Landau, Lifshitz, Mechanics, 33)."""
    omega, duration = np.array([0.5, 7.0, 0.3]), 1.0
    problem = thrown(brick(), omega, duration)
    solution = assert_outcome(Solved(None), lambda: problem, transcription="legendre:3", intervals=30)
    across, along = np.diag(brick().model.inertias[1].inertia)[[0, 2]]
    spin = omega[2] * (1 - along / across)
    momentum = np.array([across, across, along]) * omega
    pitches = []
    for t, q in zip(solution.t, solution.q, strict=True):
        exact = pin.exp3(momentum / across * t) @ pin.exp3(np.array([0.0, 0.0, spin * t]))
        found = pin.Quaternion(*q[[6, 3, 4, 5]]).matrix()
        assert np.linalg.norm(pin.log3(exact.T @ found)) < TUMBLE
        pitches.append(np.arcsin(-found[2, 0]))
    assert np.max(np.abs(pitches)) > 1.4  # close to the right angle, where angles lock, and past it


def assert_turns(axis, turns, *, goal):
    """Torques hold the legs of a quadruped against what pushes them outwards."""
    robot, omega = robots.load("solo12"), 2 * np.pi * turns * np.array(AXES[axis])
    make = lambda: held_joints(robot, omega, 1.0, goal=goal)  # noqa: E731
    settings = {"transcription": "legendre:3", "intervals": 8 * turns, "tolerance": 1e-8}
    solution = assert_outcome(Solved(FLIP), make, **settings)
    assert_allclose(turned(solution), omega, atol=NUTATION)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_quadruped_flips_whole_turns(axis, turns):
    assert_turns(axis, turns, goal=False)


@pytest.mark.parametrize("turns", [1, 3])
def test_a_quadruped_turns_to_a_goal_whole_turns_away(turns):
    assert_turns("yaw", turns, goal=True)


@pytest.mark.parametrize("kind", ["backflip", "barrel-roll"])
def test_a_flip_from_feet_to_feet_turns_once(kind):
    solution = assert_outcome(Solved(None), lambda: problems.load(f"quadruped-{kind}", robot="solo12"))
    assert abs(np.linalg.norm(turned(solution)) - 2 * np.pi) < 0.3


@pytest.mark.parametrize("end", [90, 135, 180])
def test_half_a_flip_passes_the_right_angle(end):
    make = lambda: problems.load("solo12-flip", pitch=f"{end}deg", yaw=0.0)  # noqa: E731
    solution = assert_outcome(Solved(None, coarse=5e-3), make, intervals=20)
    nose = pin.Quaternion(*solution.q[-1][[6, 3, 4, 5]]).matrix()[:, 0]
    assert_allclose(nose, [np.cos(np.radians(end)), 0.0, np.sin(np.radians(end))], atol=1e-5)


# The same orientation


def mirrored(q: np.ndarray) -> np.ndarray:
    """The same configuration with the other quaternion of its base."""
    other = q.copy()
    other[3:7] *= -1
    return other


def yawing() -> Problem:
    return held_joints(robots.load("solo12"), np.array([0.3, -0.2, 2.0]), 0.2, default_intervals=3)


def flickering(guess: Callable[[float], np.ndarray]) -> Callable[[float], np.ndarray]:
    """The guess with the sign of its quaternion changing every 13 ms."""
    return lambda t: mirrored(guess(t)) if int(t / 0.013) % 2 else guess(t)


def other_goal(problem: Problem) -> Problem:
    terms = tuple(
        TerminalState(q=mirrored(np.array(term.q))) if isinstance(term, TerminalState) else term
        for term in problem.terms
    )
    return replace(problem, terms=terms)


OTHER_SIGNS = {
    "start": lambda p: replace(p, initial_q=mirrored(p.initial_q)),
    "goal": other_goal,
    "guess": lambda p: replace(p, guess=flickering(p.guess)),
    "all": lambda p: other_goal(
        replace(p, initial_q=mirrored(p.initial_q), guess=lambda t: mirrored(p.guess(t)))
    ),
}


@lru_cache
def plain() -> Solution:
    return assert_outcome(Solved(None), yawing)


@pytest.mark.parametrize("where", OTHER_SIGNS)
def test_a_quaternion_and_its_negative_are_one_orientation(where):
    solution = assert_outcome(Solved(None), lambda: OTHER_SIGNS[where](yawing()))
    assert solution.statistics.iterations == plain().statistics.iterations
    assert solution.statistics.objective == pytest.approx(plain().statistics.objective, rel=ROUNDING)
    assert_allclose(solution.tau, plain().tau, atol=ROUNDING)
    apart = [pin.difference(solution.model, a, b) for a, b in zip(solution.q, plain().q, strict=True)]
    assert_allclose(apart, 0.0, atol=1e-9)


def test_a_continuous_joint_goes_the_short_way_past_pi():
    """Its goal is one angle of many, a turn apart: the one near the guess."""
    arm = robots.load("kinova")
    first = arm.model.joints[1].idx_q

    def at(angle: float) -> np.ndarray:
        q = arm.reference.copy()
        q[first : first + 2] = np.cos(angle), np.sin(angle)
        return q

    solution = assert_outcome(Solved(5e-3), lambda: reach(arm, at(3.0), at(-3.0)), transcription="legendre:3")
    angles = np.unwrap(np.arctan2(solution.q[:, first + 1], solution.q[:, first]))
    assert_allclose(angles[-1] - angles[0], 2 * np.pi - 6.0, atol=1e-6)


@pytest.mark.parametrize("turns", [-1, 0, 1, 2])
def test_a_planar_base_does_the_turns_of_its_guess(turns):
    """It counts its turns, and its goal is one angle of many, too: that at which the guess ends."""
    robot, duration = robots.load("hopper"), 0.8
    start = robot.reference.copy()
    start[1] += 1.0
    rate = 2 * np.pi * turns / duration
    velocity = np.zeros(robot.nv)
    velocity[:3] = 0.0, STANDARD_GRAVITY * duration / 2, rate

    def guess(t: float) -> np.ndarray:
        q = start.copy()
        q[1] += STANDARD_GRAVITY * t * (duration - t) / 2
        q[2:4] = np.cos(rate * t), np.sin(rate * t)
        return q

    problem = replace(
        held_joints(robots.load("solo12"), np.zeros(3), duration),
        robot=robot,
        initial_q=start,
        initial_v=velocity,
        terms=(
            TorqueCost(weight=1.0),
            PostureCost(weight=1.0),
            AccelerationCost(weight=1e-2, joints_only=True),
            TerminalState(q=guess(duration)),
        ),
        guess=guess,
    )
    solution = assert_outcome(None, lambda: problem, intervals=10)
    assert solution.converged
    angle = np.unwrap(np.arctan2(solution.q[:, 3], solution.q[:, 2]))
    assert_allclose(angle[-1] - angle[0], 2 * np.pi * turns, atol=1e-6)


# Half turns and gimbal lock


@pytest.mark.parametrize("axis", ["pitch", "yaw"])
def test_a_guess_that_ends_exactly_opposite_to_its_goal_is_named(axis):
    """No direction leads from a rotation to its opposite: the error has a pole there, and no false zero."""
    problem = held_joints(robots.load("solo12"), np.pi * np.array(AXES[axis]), 1.0)
    opposite = replace(problem, guess=lambda t: problem.initial_q)
    failed = Failed(Status.NOT_FINITE, block="terminal_state", advice="'terminal_state' in phase 'flight'")
    assert_outcome(failed, lambda: opposite, intervals=4)


@pytest.mark.parametrize("degrees", [0.5, 1.0, 2.0])
def test_a_guess_a_degree_off_the_opposite_is_enough(degrees: float):
    problem = held_joints(robots.load("solo12"), np.pi * np.array(AXES["yaw"]), 1.0)
    near = problem.initial_q.copy()
    near[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, np.radians(degrees)]))).coeffs()
    solution = assert_outcome(Solved(None), lambda: replace(problem, guess=lambda t: near), intervals=10)
    # There are several optima: in some the legs swing, and the base rolls on its way.
    assert_allclose(turned(solution)[2], np.pi, atol=1e-2)


def pitched(angle: float) -> Problem:
    """The quadruped thrown with its base pitched by ``angle`` rad at the start."""
    robot = robots.load("solo12")
    problem = thrown(robot, np.zeros(3), 0.3, terms=(TorqueCost(weight=1.0), PostureCost(weight=1.0)))
    q = problem.initial_q.copy()
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, angle, 0.0]))).coeffs()
    return replace(problem, initial_q=q, guess=lambda t: q)


def test_virtual_joints_that_start_in_gimbal_lock_are_refused_and_a_quaternion_is_not():
    assert_outcome(Refused("starts in gimbal lock"), lambda: with_virtual_base(pitched(np.pi / 2)))
    assert_outcome(Solved(EXACT), lambda: pitched(np.pi / 2), intervals=5)
    virtual = with_virtual_base(pitched(0.0))
    locked = virtual.initial_q.copy()
    locked[4] = np.pi / 2
    assert_outcome(Refused("starts in gimbal lock"), lambda: replace(virtual, initial_q=locked))


def test_virtual_joints_that_pass_gimbal_lock_are_no_success():
    problem = held_joints(robots.load("solo12"), np.array([0.0, -2 * np.pi, 0.0]) / 2, 1.0)
    passing = Failed(Status.SINGULAR_BASE, advice="use base='freeflyer'")
    solution = assert_outcome(passing, lambda: with_virtual_base(problem), intervals=10)
    assert solution.statistics.gimbal_margin < 0.05
    other = assert_outcome(Solved(None), lambda: with_virtual_base(problem, "YXZ"), intervals=10)
    assert other.statistics.gimbal_margin > 0.5
