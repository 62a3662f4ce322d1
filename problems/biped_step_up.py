"""A biped steps onto a box, or down: shift, one foot over the edge, double support, the other foot, rest."""

from __future__ import annotations

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.reduced.base_path import BaseWaypoint
from trajopt.reduced.legged_guess import legged_guess
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import biped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import TerminalRest, TerminalState, swing_clearance
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.swing_path import swing_path

from . import bipeds, common, leaping

# Height of the box and way forward, parts of the robot's length; a way of so many soles at least.
HEIGHT, FORWARD, SOLES = 0.15, 0.4, 1.6
# Durations in units of sqrt(l / g).
SHIFT, STEP, DOUBLE = 3.5, 3.2, 2.0
# In the guess the base goes this part of the way to over the standing foot, and has done these parts of its
# way forward and of its rise at the ends of the phases.
SWAY = 0.7
DONE_FORWARD, DONE_UP = (0.1, 0.35, 0.65, 0.95), (0.0, 0.2, 0.6, 1.0)
CLEARANCE = 0.05
# The box begins this part of the way before the heels that land on it: room to lift a foot before its edge.
BEFORE_HEEL = 0.1
INTERVALS = 50


def _path(robot: Robot, times: np.ndarray, forward: float, height: float) -> list[BaseWaypoint]:
    """The base at the start and at the end of every phase: over the foot that stands alone."""
    feet, base = contact_positions(robot, robot.reference), robot.reference[1]
    left, right = (SWAY * float(feet[name][1] - base) for name in biped_legs(robot))
    sides = (left, left, right, right)
    shifts = [(0.0, 0.0, 0.0)]
    shifts += [(x * forward, y, z * height) for x, y, z in zip(DONE_FORWARD, sides, DONE_UP, strict=True)]
    shifts.append((forward, 0.0, height))
    return [bipeds.waypoint(robot, float(time), shift) for time, shift in zip(times, shifts, strict=True)]


def _schedule(robot: Robot, forward: float, height: float, durations: tuple[float, float, float]) -> Schedule:
    """The right foot steps first, then the left one, each to its place on the box."""
    left, right = biped_legs(robot)
    shift, step, double = durations
    moved = {
        name: place + np.array([forward, 0.0, height])
        for name, place in contact_positions(robot, robot.reference).items()
    }
    return Schedule(
        (
            Phase(name="shift", duration=shift, contacts=(left, right)),
            Phase(name="step_1", duration=step, contacts=(left,)),
            Phase(name="double", duration=double, contacts=(left, right), footholds={right: moved[right]}),
            Phase(name="step_2", duration=step, contacts=(right,)),
            Phase(name="settle", duration=shift, contacts=(left, right), footholds={left: moved[left]}),
        )
    )


def build(
    *,
    robot: str,
    height: float | None,
    forward: float | None,
    shift: float | None,
    step: float | None,
    double: float | None,
    friction: float,
    effort_share: float,
) -> Problem:
    """Build the step; see ``FAMILY`` for the parameters. Raises InputError."""
    body = bipeds.biped(robot)
    unit, sole = leaping.natural_time(body), 2 * max(contact.half_length for contact in body.contacts)
    height = HEIGHT * body.length if height is None else height
    forward = max(FORWARD * body.length, SOLES * sole) if forward is None else forward
    if not forward > sole:
        raise InputError(
            f"biped-step-up goes {forward:g} m forward on soles of {sole:g} m", "allowed: more than a sole"
        )
    given = zip((shift, step, double), (SHIFT, STEP, DOUBLE), strict=True)
    durations = tuple(unit * scaled if value is None else value for value, scaled in given)
    heel = float(np.mean([place[0] for place in contact_positions(body, body.reference).values()]))
    edge = heel - sole / 2 + (1 - BEFORE_HEEL) * forward
    terrain = PiecewiseTerrain.steps([height], forward, at=(edge, 0.0), friction=friction)
    schedule = _schedule(body, forward, height, durations)
    times = np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])
    lift = CLEARANCE * body.length
    swing = swing_path(terrain, lift, reach=sole / 2)
    guess = legged_guess(body, schedule, _path(body, times, forward, height), terrain=terrain, swing=swing)
    end = leaping.displaced(body, (forward, 0.0, height))
    return Problem(
        name="biped-step-up",
        robot=body,
        schedule=schedule,
        terrain=terrain,
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(
            *common.legged_costs(acceleration=bipeds.ACCELERATION),
            *bipeds.limits(body, effort_share),
            *swing_clearance(body, schedule, terrain, height=lift, guess=guess),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=guess,
        parameters={
            "height": height,
            "forward": forward,
            "shift": durations[0],
            "step": durations[1],
            "double": durations[2],
        },
        default_intervals=INTERVALS,
    )


def _length(name: str, meaning: str, within: common.Range) -> Parameter:
    return Parameter(name=name, default=None, unit="m", lower=within[0], upper=within[1], meaning=meaning)


FAMILY = Family(
    name="biped-step-up",
    robots=bipeds.ROBOTS,
    phases=("shift", "step_1", "double", "step_2", "settle"),
    summary="step onto a box (or down, with a negative height), one foot after the other, and rest",
    parameters=(
        _length("height", "of the box (default: 0.15 of the robot's length)", (-1.0, 1.0)),
        _length("forward", "way of the feet (default: 0.4 of the robot's length)", (0.0, 2.0)),
        common.duration("shift", None, "before the first step, and after the second", (0.05, 10.0)),
        common.duration("step", None, "of a swing", (0.05, 10.0)),
        common.duration("double", None, "on both feet between the steps", (0.02, 10.0)),
        common.friction(0.7),
        common.effort_share(),
    ),
    build=build,
)
