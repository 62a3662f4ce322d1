"""Solo12 hops uphill on a slope: every contact normal is tilted against gravity."""

import math
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt.dynamics import STANDARD_GRAVITY
from trajopt.problem import Family, Problem
from trajopt.robot import Robot
from trajopt.schedule import footholds_at, middle_of
from trajopt.terms import FrameHeight, FrictionCone
from trajopt.terrain import FlatGround
from trajopt_library import robots
from trajopt_library.robots.solo12 import BASE

from . import common, leaping

# Shortest flight in which feet can move, s.
SHORTEST_FLIGHT = 0.2


def _standing(robot: Robot, ground: FlatGround, uphill: float) -> np.ndarray:
    """Return the reference posture placed on the slope, trunk parallel to it, ``uphill`` m along it."""
    turn = ground.surface.frame
    q = common.displaced(robot, (uphill, 0.0, 0.0))
    q[:3] = turn @ q[:3] + ground.surface.point
    q[3:7] = pin.Quaternion(turn @ pin.Quaternion(q[3:7]).toRotationMatrix()).coeffs()
    return q


def _guess(start: np.ndarray, end: np.ndarray, stance: float, flight: float, t: float) -> np.ndarray:
    """Stand still; in flight follow a parabola from one stance to the other with the legs of standing."""
    s = min(max((t - stance) / flight, 0.0), 1.0)
    q = start.copy()
    q[:3] += s * (end - start)[:3]
    q[2] += STANDARD_GRAVITY * flight**2 * s * (1 - s) / 2
    return q


def build(
    *,
    slope: float,
    distance: float,
    height: float,
    stance: float,
    flight: float | None,
    landing: float,
    friction: float,
    torque_limit: float | None,
) -> Problem:
    """Build the hop; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("solo12")
    ground = FlatGround(friction=friction, normal=(-math.sin(slope), 0.0, math.cos(slope)))
    start, end = (_standing(robot, ground, uphill) for uphill in (0.0, distance))
    time = max(SHORTEST_FLIGHT, 2 * math.sqrt(2 * height / STANDARD_GRAVITY)) if flight is None else flight

    return common.problem(
        "solo12-slope",
        robot,
        common.hop_schedule(footholds_at(robot, end, ground), (stance, time, landing)),
        partial(_guess, start, end, stance, time),
        costs=leaping.COSTS,
        torque_limit=torque_limit,
        cones=(FrictionCone(),),
        terrain=ground,
        clearance=common.CLEARANCE,
        more=(FrameHeight(frame=BASE, height=start[2] + height, at=middle_of("flight")),),
        end=end,
        initial_q=start,
        default_intervals=40,
    )


FAMILY = Family(
    name="solo12-slope",
    robot="solo12",
    phases=("stance", "flight", "landing"),
    summary="hop along a slope and come to rest, with friction cones about its normal",
    parameters=(
        common.angle("slope", math.radians(20), "angle of the slope, positive: rises forward", (-0.7, 0.7)),
        common.length("distance", 0.1, "forward displacement along the slope", (-0.5, 0.5)),
        common.length("height", 0.05, "least rise of the base over its start in mid flight", (0.0, 0.4)),
        *common.hop_durations("from the height, at least 0.2", (0.3, None, 0.4), longest=2.0),
        common.friction(0.8),
        common.TORQUE_LIMIT,
    ),
    build=build,
)
