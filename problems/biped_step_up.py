"""A biped steps onto a box, or down: shift, one foot over the edge, double support, the other foot, rest."""

import numpy as np

from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.robot import Robot, Units, biped_legs, contact_positions
from trajopt.terrain import PiecewiseTerrain, swing_path

from . import bipeds, common

PHASES = ("shift", "step_1", "double", "step_2", "settle")
# Height of the box and forward displacement over the robot's length; least displacement over the sole length.
HEIGHT, FORWARD, SOLES = 0.15, 0.4, 1.6
# Durations in units of sqrt(l / g).
SHIFT, STEP, DOUBLE = 3.5, 3.2, 2.0
# In the guess the base moves sideways by this fraction of the distance to the standing foot. At the ends of
# the phases it has covered these fractions of its forward displacement and of its rise.
SWAY = 0.7
DONE_FORWARD, DONE_UP = (0.1, 0.35, 0.65, 0.95), (0.0, 0.2, 0.6, 1.0)
CLEARANCE = 0.05
# The box begins this fraction of the displacement before the landing heels: room to lift a foot.
BEFORE_HEEL = 0.1
INTERVALS = 50


def _path(robot: Robot, times: np.ndarray, forward: float, height: float) -> list[BaseWaypoint]:
    """Return the base at the start and the end of every phase: over the foot that stands alone."""
    feet, base = contact_positions(robot, robot.reference), robot.reference[1]
    left, right = (SWAY * float(feet[name][1] - base) for name in biped_legs(robot))
    sides = (left, left, right, right)
    shifts = [(0.0, 0.0, 0.0)]
    shifts += [(x * forward, y, z * height) for x, y, z in zip(DONE_FORWARD, sides, DONE_UP, strict=True)]
    shifts.append((forward, 0.0, height))
    return [bipeds.waypoint(robot, float(time), shift) for time, shift in zip(times, shifts, strict=True)]


def build(*, robot: str, friction: float, torque_share: float, **given: float | None) -> Problem:
    """Build the step; see ``FAMILY`` for the parameters. Raises InputError."""
    body = bipeds.biped(robot)
    unit, sole = Units(body).time, 2 * max(contact.half_length for contact in body.contacts)
    defaults = {
        "height": HEIGHT * body.length,
        "forward": max(FORWARD * body.length, SOLES * sole),
        "shift": SHIFT * unit,
        "step": STEP * unit,
        "double": DOUBLE * unit,
    }
    values = common.filled(defaults, given)
    height, forward, shift, step, double = values.values()
    if not forward > sole:
        raise InputError(
            f"biped-step-up moves {forward:g} m forward on soles of {sole:g} m", "allowed: more than a sole"
        )
    heel = float(np.mean([place[0] for place in contact_positions(body, body.reference).values()]))
    edge = heel - sole / 2 + (1 - BEFORE_HEEL) * forward
    terrain = PiecewiseTerrain.steps([height], forward, at=(edge, 0.0), friction=friction)
    way = np.array([forward, 0.0, height])
    durations = dict(zip(PHASES, (shift, step, double, step, shift), strict=True))
    schedule = bipeds.two_steps(body, way, durations)
    times = np.cumsum([0.0, *durations.values()])
    lift = CLEARANCE * body.length
    radii = {contact.name: contact.radius for contact in body.contacts}
    swing = swing_path(terrain, lift, reach=sole / 2, radii=radii)
    return common.problem(
        "biped-step-up",
        body,
        schedule,
        legged_guess(body, schedule, _path(body, times, forward, height), terrain=terrain, swing=swing),
        torque_share=torque_share,
        terrain=terrain,
        clearance=lift,
        end=common.displaced(body, way),
        parameters=values,
        default_intervals=INTERVALS,
    )


FAMILY = Family(
    name="biped-step-up",
    robots=bipeds.ROBOTS,
    phases=PHASES,
    summary="step onto a box (or down, with a negative height), one foot after the other, and rest",
    parameters=(
        common.length("height", None, "height of the box (default: 0.15 of the robot's length)", (-1.0, 1.0)),
        common.length(
            "forward", None, "displacement of the feet (default: 0.4 of the robot's length)", (0.0, 2.0)
        ),
        common.duration("shift", None, "duration before the first step, and after the second", (0.05, 10.0)),
        common.duration("step", None, "duration of a swing", (0.05, 10.0)),
        common.duration("double", None, "duration of double support", (0.02, 10.0)),
        common.friction(0.7),
        common.TORQUE_SHARE,
    ),
    build=build,
)
