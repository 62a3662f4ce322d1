"""Swing-ups of pendulums: from hanging to upright at rest, with motors too weak to lift them at once."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt.dynamics import Coordinates
from trajopt.errors import InputError
from trajopt.problem import Family, Parameter, Problem
from trajopt.robot import Robot
from trajopt.schedule import Phase, Schedule
from trajopt.terms import effort_costs, goal_terms
from trajopt.terrain import smooth_step
from trajopt_library import robots

from . import common

# Default duration in periods of the hanging links: time for several swings; for least time, the guess.
PERIODS = {"effort": 2.5, "time": 1.5}
# A swing-up has no posture to keep and no contacts, and must be fast, so rates cost less than on legs.
EFFORT = effort_costs(acceleration=1e-3, velocity=3e-3, posture=0.0)
# Fraction of the torque that would just hold the links stretched out and level.
WEAK = 0.5
# Bounds of a free duration over the nominal one.
FREE = (0.2, 2.0)
# Moments below this fraction of the largest count as zero: real links do not balance exactly.
BALANCED = 1e-2
INTERVALS_PER_PERIOD = 20
DISTANCE = common.number("distance", 1.0, "m", "where the cart ends", (-10.0, 10.0))
LEAST_INTERVALS = 50


def _pendulum(robot: Robot) -> tuple[np.ndarray, float]:
    """Return half a turn (nv,) of the first joint that swings the robot upright, and its period, s.

    The robot hangs at its reference. The period is that of small swings with all other joints locked. Raises
    InputError if the robot is not such a pendulum.
    """
    model, data, hanging = robot.model, robot.model.createData(), robot.reference
    if robot.base == "fixed" and robot.nu > 0 and not robot.contacts:
        start = Coordinates(model).node_from_pinocchio(hanging, np.zeros(robot.nv))
        for row in (joint.idx_v for joint in model.joints[1:] if joint.nv == 1):
            turn = np.zeros(robot.nv)
            turn[row] = -math.pi if start[row] > 0 else math.pi
            way = [pin.integrate(model, hanging, share * turn) for share in (0.0, 0.5, 1.0)]
            moments = [np.abs(pin.computeGeneralizedGravity(model, data, q)).max() for q in way]
            low, _, high = (pin.computePotentialEnergy(model, data, q) for q in way)
            if high > low and max(moments[0], moments[2]) <= BALANCED * moments[1]:
                inertia = pin.crba(model, data, hanging)[row, row]
                return turn, 2 * math.pi * math.sqrt(inertia / moments[1])
    raise InputError(
        f"robot '{robot.name}' is not a pendulum that hangs in its reference posture",
        "allowed: a fixed base, and half a turn of a joint from there to the upright balance",
    )


def _turning(pendulum: Robot, turn: np.ndarray, duration: float, t: float) -> np.ndarray:
    """Return the guess: the joints at ``t`` s of their smooth turn."""
    turned = smooth_step(t / duration) * turn
    return np.asarray(pin.integrate(pendulum.model, pendulum.reference, turned))


def build(
    *, robot: str, goal: str, duration: float | None, torque_share: float, distance: float = 0.0
) -> Problem:
    """Build the swing-up; see ``FAMILIES`` for the parameters. Raises InputError."""
    pendulum = robots.load(robot)
    turn, period = _pendulum(pendulum)
    turn[0] += distance
    nominal = PERIODS[goal] * period if duration is None else duration
    schedule = Schedule((Phase(name="swing", duration=nominal),))
    schedule = common.freed(schedule, FREE) if goal == "time" else schedule

    return common.problem(
        pendulum.name.replace("_", "-"),
        pendulum,
        schedule,
        partial(_turning, pendulum, turn, nominal),
        costs=goal_terms(goal, pendulum, schedule, effort=EFFORT),
        torque_share=torque_share,
        end=_turning(pendulum, turn, nominal, nominal),
        parameters={"duration": nominal},
        default_intervals=max(LEAST_INTERVALS, round(INTERVALS_PER_PERIOD * nominal / period)),
    )


def _family(
    robot: str, summary: str, *more: Parameter, share: float = WEAK, duration: float | None = None
) -> Family:
    return Family(
        name=robot.replace("_", "-"),
        robots=(robot,),
        phases=("swing",),
        summary=summary,
        parameters=(
            common.goal(*PERIODS),
            common.duration(
                "duration",
                duration,
                "duration, with goal=time its guess (default: from the period of the hanging links)",
                (1e-2, 60.0),
            ),
            replace(common.TORQUE_SHARE, default=share),
            *more,
        ),
        build=build,
    )


FAMILIES = (
    _family("double_pendulum", "swing two links up from hanging to upright, at rest"),
    _family("acrobot", "swing two links up from hanging to upright, with a motor only between them"),
    _family("pendubot", "swing two links up from hanging to upright, with a passive elbow"),
    _family("cart_pole", "push a cart aside so that its pole swings up", DISTANCE, share=1.0, duration=2.0),
    _family("furuta", "turn an arm so that the pole at its end swings up", share=1.0),
)
