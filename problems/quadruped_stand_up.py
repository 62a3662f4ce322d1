"""A quadruped stands up: from lying low on folded legs, feet in place, to its standing posture, at rest."""

import numpy as np

from trajopt.collision import robot_shapes
from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.problem.bodies import GAP_SLACK
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.robot import Robot, Units, frame_pose
from trajopt.schedule import Phase, Schedule
from trajopt.terms import TimeCost

from . import common, leaping, pushing

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Default duration in units of sqrt(l / g), and bounds of a free one as multiples of it.
DURATION, FREE = 5.0, (0.2, 2.0)
# Weight of time as a goal: sqrt(l / g) then costs as much as torques of weight times length during that time.
TIME_WEIGHT = 1.0
# Base height of a lying robot over its length: half the thickness of the trunk.
LYING = 0.3
# Largest fraction of the limits that static torques use at the start.
STATIC_SHARE = 0.7
# Tolerance of depths over the robot's length.
DEPTH_ERROR = 1e-3


def deepest(robot: Robot, torque_limit: float | None) -> float:
    """How far the base sinks under its standing height until it lies, m, by bisection.

    As far as legs fold within their limits, links stay apart, hips and knees above the ground, and torques
    hold the robot.
    """
    standing = float(robot.reference[2]) - common.foot_radius(robot)  # above the centres of the feet
    most = max(standing - LYING * robot.length, 0.0)
    if _lies(robot, most, torque_limit):
        return most
    return pushing.largest(lambda depth: _lies(robot, depth, torque_limit), most, DEPTH_ERROR * robot.length)


def _lies(robot: Robot, depth: float, torque_limit: float | None) -> bool:
    """Return whether a robot can rest with its base ``depth`` m below its standing height."""
    posture = pushing.raised(robot, -depth)
    if posture.error > pushing.REACHED:
        return False
    limit = robot.torque_limit if torque_limit is None else np.full(robot.nu, torque_limit)
    if pushing.strongest(robot, posture.q, limit) * STATIC_SHARE < 1:
        return False
    scene = robot_shapes(robot).scene(robot.model)
    if scene.pairs and scene.distances_at(posture.q).min() < -GAP_SLACK:
        return False
    frames, keep = leaping.hips_and_knees(robot), leaping.joint_clearance(robot)
    return all(frame_pose(robot, posture.q, frame).translation[2] > keep for frame in frames)


def build(
    *,
    robot: str,
    depth: float | None,
    duration: float | None,
    goal: str,
    friction: float,
    torque_limit: float | None,
) -> Problem:
    """Build the motion; see ``FAMILY`` for the parameters. Raises InputError."""
    body = common.quadruped(robot)
    depth = deepest(body, torque_limit) if depth is None else depth
    duration = DURATION * Units(body).time if duration is None else duration
    lying = pushing.raised(body, -depth)
    if lying.error > pushing.REACHED:
        raise InputError(
            f"'{body.name}' cannot fold its legs by {depth:g} m",
            f"allowed: up to {deepest(body, torque_limit):.3f} m",
        )
    contacts = tuple(contact.name for contact in body.contacts)
    schedule = Schedule((Phase(name="rise", duration=duration, contacts=contacts),))
    fast = goal == "time"
    schedule = common.freed(schedule, FREE) if fast else schedule
    path = [
        BaseWaypoint(time=0.0, position=lying.q[:3]),
        BaseWaypoint(time=duration, position=body.reference[:3]),
    ]
    return common.problem(
        "quadruped-stand-up",
        body,
        schedule,
        legged_guess(body, schedule, path, start=lying.q),
        costs=(*leaping.COSTS, TimeCost(weight=TIME_WEIGHT)) if fast else leaping.COSTS,
        torque_limit=torque_limit,
        friction=friction,
        more=leaping.above_ground(body, {"rise": 0.0}),
        end=body.reference,
        initial_q=lying.q,
        parameters={"depth": depth, "duration": duration},
        default_intervals=30,
    )


FAMILY = Family(
    name="quadruped-stand-up",
    robots=ROBOTS,
    phases=("rise",),
    summary="rise from lying low on folded legs to standing, feet in place",
    parameters=(
        common.length(
            "depth",
            None,
            "depth of the base under its standing height at the start (default: the deepest)",
            (0.0, 2.0),
        ),
        common.duration("duration", None, "duration; with goal=time its guess", (1e-2, 20.0)),
        common.goal("effort", "time", meaning="objective: torques or time"),
        common.friction(0.7),
        common.TORQUE_LIMIT,
    ),
    build=build,
)
