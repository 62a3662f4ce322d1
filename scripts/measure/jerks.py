"""Least time with limits of jerk: beside closed forms of integrators, and beside ruckig from rest to rest."""

import math
from dataclasses import replace

import click
import numpy as np
import pinocchio as pin

import trajopt
from trajopt import Phase, Problem, Robot, Schedule, Solution
from trajopt.robot import JointLimits
from trajopt.terms import (
    AccelerationLimits,
    Clearance,
    JerkCost,
    JerkLimits,
    PositionLimits,
    Term,
    TerminalRest,
    TerminalState,
    TimeCost,
    VelocityLimits,
)

# Limits of a mass that moves a metre: jerk in m/s^3, acceleration in m/s^2, speed in m/s.
CASES = ((10.0, math.inf, math.inf), (10.0, 2.0, math.inf), (10.0, 2.0, 0.8))
# Limits of arms whose makers state none, as in their users' controllers: rad/s^2 and rad/s^3.
ASSUMED = {"ur5": (14.0, 200.0), "z1": (20.0, 500.0)}
ARMS, MOVES, SEED, SHARE, TURN = ("panda", "xarm7", "ur5", "z1"), 3, 0, 0.6, 2.5
INTERVALS = {"panda": 240}
USUAL = 60


@click.command
def jerks() -> None:
    """Print least durations with limits of jerk beside closed forms and ruckig (uv run --with ruckig)."""
    print("| move | intervals | iterations | duration | reference | longer by |")
    print("|---|---|---|---|---|---|")
    for limits in CASES:
        _row(f"1 m, limits {', '.join(f'{limit:g}' for limit in limits)}", _slide(*limits), _fastest(*limits))
    for name in ARMS:
        random = np.random.default_rng(SEED)
        for number in range(MOVES):
            _row(f"{name}, move {number + 1}", *_move(name, random))


def _row(what: str, solution: Solution, reference: float) -> None:
    statistics, duration = solution.statistics, float(solution.t[-1])
    if not solution.converged:
        what += f" ({statistics.status})"
    longer = 100 * (duration / reference - 1)
    numbers = f"{solution.n_intervals} | {statistics.iterations} | {duration:.4f} s | {reference:.4f} s"
    print(f"| {what} | {numbers} | {longer:.2f} % |")


def _problem(robot: Robot, start: np.ndarray, goal: np.ndarray, guess: float, intervals: int) -> Problem:
    still = (TerminalState(q=goal), TerminalRest(q=goal), Clearance(shapes=(), self_collision=False))
    limits: list[Term] = [JerkLimits(), VelocityLimits(), PositionLimits()]
    if np.isfinite(robot.joint_limit("acceleration")).any():
        limits.append(AccelerationLimits())
    return Problem(
        name="move",
        robot=robot,
        schedule=Schedule((Phase(name="move", duration=guess, duration_bounds=(0.1 * guess, 4 * guess)),)),
        initial_q=start,
        actuation="jerk",
        terms=(TimeCost(weight=1.0), JerkCost(weight=1e-5), *limits, *still),
        default_intervals=intervals,
        default_transcription="legendre:1",
    )


def _slide(jerk: float, acceleration: float, speed: float) -> Solution:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    robot = Robot.from_model(model, name="slider", base="fixed")
    limits = JointLimits(joint="rail", acceleration=acceleration, jerk=jerk)
    robot = replace(robot, velocity_limit=np.array([speed])).with_joint_limits([limits])
    return trajopt.solve(_problem(robot, np.zeros(1), np.ones(1), 2.0, USUAL))


def _fastest(jerk: float, acceleration: float, speed: float) -> float:
    """Least duration in s over a metre from rest to rest: four, six or seven arcs of constant jerk."""
    if not math.isfinite(acceleration):
        return (32 / jerk) ** (1 / 3)
    ramp = acceleration / jerk
    duration = ramp + math.sqrt(ramp**2 + 4 / acceleration)
    if acceleration * (duration / 2 - ramp) <= speed:
        return duration
    return 1 / speed + speed / acceleration + ramp


def _move(name: str, random: np.random.Generator) -> tuple[Solution, float]:
    """A move of all joints between two random postures, and ruckig's duration for the same limits."""
    from ruckig import InputParameter, Ruckig, Trajectory  # type: ignore[import-not-found, unused-ignore]

    robot = trajopt.robot(name)
    if name in ASSUMED:
        acceleration, jerk = ASSUMED[name]
        joints = list(robot.model.names)[1:]
        robot = robot.with_joint_limits(
            [JointLimits(joint=joint, acceleration=acceleration, jerk=jerk) for joint in joints]
        )
    low, high = np.maximum(robot.position_lower, -TURN), np.minimum(robot.position_upper, TURN)
    start, goal = (robot.reference + SHARE * (random.uniform(low, high) - robot.reference) for _ in range(2))
    asked, found = InputParameter(robot.nv), Trajectory(robot.nv)
    asked.current_position, asked.target_position = start, goal
    asked.max_velocity = robot.velocity_limit
    asked.max_acceleration, asked.max_jerk = robot.joint_limit("acceleration"), robot.joint_limit("jerk")
    Ruckig(robot.nv).calculate(asked, found)
    problem = _problem(robot, start, goal, 1.2 * found.duration, INTERVALS.get(name, USUAL))
    return trajopt.solve(problem), float(found.duration)
