"""A jump of Solo12: stance, flight, landing on the footholds of the target pose, rest."""

import math

import numpy as np

from trajopt.dynamics import STANDARD_GRAVITY
from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.reduced import BaseWaypoint, WaypointPath, legged_guess
from trajopt.robot import Robot
from trajopt.schedule import Schedule, footholds_at, middle_of
from trajopt.terms import DriveLimits, FrameHeight, ImpulseCost, Term
from trajopt_library import robots
from trajopt_library.robots import solo12

from . import common, leaping

# Shortest flight in which feet can move to their new footholds, s.
SHORTEST_FLIGHT = 0.3
# Rise of the base above its standing height at take-off in the guess, m: legs are not yet straight.
TAKEOFF_RISE = 0.04
# Displacement of the base while the feet stand, over take-off speed times duration.
GROUND_SHARE = 0.15


def _path(robot: Robot, schedule: Schedule, distance: float, yaw: float) -> WaypointPath:
    """Return the base path: a smooth push, a parabola and a smooth landing."""
    stance, flight, landing = (phase.duration for phase in schedule.phases)
    parts = np.array([0.0, GROUND_SHARE * stance, flight, GROUND_SHARE * landing])
    parts /= parts.sum()
    times, rises = np.cumsum([0.0, stance, flight, landing]), (0.0, TAKEOFF_RISE, TAKEOFF_RISE, 0.0)
    waypoints = [
        BaseWaypoint(
            time=float(time),
            position=robot.reference[:3] + np.array([done * distance, 0.0, rise]),
            turn=(0.0, 0.0, part * yaw),
        )
        for time, part, done, rise in zip(times, parts, np.cumsum(parts), rises, strict=True)
    ]
    return WaypointPath(schedule, waypoints)


def _actuated(torque_limit: float | None, voltage: float | None) -> tuple[Robot, Term]:
    """Return the robot, with motors at a supply voltage if given, and the term that limits its torques."""
    robot = robots.load("solo12")
    if voltage is None:
        return robot, common.torque_limits(robot, torque_limit)
    if torque_limit is not None:
        raise InputError(
            f"solo12-jump has both torque_limit={torque_limit:g} and voltage={voltage:g}",
            "allowed: one of them; with a voltage the motors' currents limit torques",
        )
    return robot.with_drives((solo12.drive(voltage),) * robot.nu), DriveLimits()


def build(
    *,
    distance: float,
    height: float,
    yaw: float,
    stance: float,
    flight: float | None,
    landing: float,
    friction: float,
    torque_limit: float | None,
    voltage: float | None,
    touchdown: str,
) -> Problem:
    """Build the jump; see ``FAMILY`` for the parameters. Raises InputError."""
    robot, torque_limits = _actuated(torque_limit, voltage)
    # Apex of a parabola between standing heights, plus the rise from extending the legs.
    needed = 2 * math.sqrt(2 * max(height - TAKEOFF_RISE, 0.0) / STANDARD_GRAVITY)
    flight = max(SHORTEST_FLIGHT, needed) if flight is None else flight
    end = common.displaced(robot, (distance, 0.0, 0.0), yaw)
    impact = touchdown == "impact"
    soft = (ImpulseCost(weight=common.IMPULSE_WEIGHT),) if impact else ()
    schedule = common.hop_schedule(footholds_at(robot, end), (stance, flight, landing), impact=impact)
    return common.problem(
        "solo12-jump",
        robot,
        schedule,
        legged_guess(robot, schedule, _path(robot, schedule, distance, yaw), clearance=common.CLEARANCE),
        costs=(*leaping.COSTS, *soft),
        torques=torque_limits,
        friction=friction,
        clearance=common.CLEARANCE,
        more=(FrameHeight(frame=solo12.BASE, height=robot.reference[2] + height, at=middle_of("flight")),),
        end=end,
        parameters={"flight": flight},
    )


FAMILY = Family(
    name="solo12-jump",
    robot="solo12",
    phases=("stance", "flight", "landing"),
    summary="jump from stance to a target pose, land on its footholds and come to rest",
    parameters=(
        common.length("distance", 0.3, "forward displacement", (-1.0, 1.0)),
        common.length("height", 0.0, "least rise of the base over standing in mid flight", (0.0, 0.6)),
        common.angle("yaw", 0.0, "turn to the left", (-math.pi / 2, math.pi / 2)),
        *common.hop_durations("from the height, at least 0.3", (0.4, None, 0.5), longest=2.0),
        common.friction(0.7),
        common.TORQUE_LIMIT,
        common.number(
            "voltage",
            None,
            "V",
            "supply of the robot's own motors (24 V), with rotor inertia, current limit and "
            "torque-speed envelope (default: joints without motors)",
            (1.0, 60.0),
        ),
        common.TOUCHDOWN,
    ),
    build=build,
)
