"""Leaps of legged robots: a push from standing feet, a flight, and a landing that ends at rest.

All of it follows from the robot: its length l, the time sqrt(l / g), and the remaining extension of its legs
(`pushing`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics import gravity_of
from trajopt.problem import Problem
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.robot import Robot, contact_positions, frame_pose, leg_joints
from trajopt.schedule import footholds_at
from trajopt.terms import FramesAbove, Term, effort_costs, goal_terms
from trajopt.terrain import Terrain

from . import common
from .pushing import Takeoff, sink_of

# Largest motion and turn of the base in the guess while the feet stand: over the robot's length, and rad.
GROUND_PART = 0.2
GROUND_TURN = 0.35
# Largest fraction of the stance in which the guess pushes, and of the landing in which it brakes.
PUSH_PART = 0.7
# Least distance over which the guess pushes or brakes, over the distance by which the robot sinks.
LEAST_WAY = 0.5
# Least foot height above the ground in mid-flight: the lesser of a fraction of the robot's length and a
# fraction of the base's ballistic rise, so that slow legs need not be drawn up.
CLEARANCE_PART, FREE_PART = 0.1, 0.5
# Least height of hips and knees above the ground, over the robot's length.
JOINT_CLEARANCE = 0.15
# Costs of leaps, with accelerations for smoothness.
COSTS = effort_costs(acceleration=2e-2)
# Bounds of free durations, for least time, as multiples of the nominal ones.
FREE = (0.5, 2.0)


def base_path(
    takeoff: Takeoff,
    ends: tuple[np.ndarray, np.ndarray],
    durations: tuple[float, float, float],
    yaw: float,
    touchdown_rise: float | None = None,
) -> tuple[BaseWaypoint, ...]:
    """Rest, lowest point of the push, take-off, touchdown, lowest point of the landing, rest.

    From one place of the base (3,) m to another, turning by ``yaw`` rad; ``durations`` of stance, flight and
    landing, s; it touches down ``touchdown_rise`` m over its end, by default as far as at take-off.
    """
    robot, (start, end), (stance, flight, landing) = takeoff.robot, ends, durations
    touchdown, low = stance + flight, takeoff.rise if touchdown_rise is None else touchdown_rise
    rising, climb = gravity_of(robot.model) * flight / 2, float(end[2] + low - start[2] - takeoff.rise)
    push_time, push_depth = _push(robot, takeoff.rise, climb / flight + rising, stance)
    brake_time, brake_depth = _push(robot, low, rising - climb / flight, landing)
    # Fractions of the displacement before take-off and after touchdown, at constant acceleration.
    whole = push_time / 2 + flight + brake_time / 2
    parts = (push_time / 2 / whole, brake_time / 2 / whole)
    up, still = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    across, turn = (end - start) * [1, 1, 0], yaw * up
    moved = [_clipped(part * across, GROUND_PART * robot.length) for part in parts]
    turned = [_clipped(part * turn, GROUND_TURN) for part in parts]
    poses = [
        (0.0, start, still),
        (stance - push_time, start - push_depth * up, still),
        (stance, start + moved[0] + takeoff.rise * up, turned[0]),
        (touchdown, end - moved[1] + low * up, turn - turned[0] - turned[1]),
        (touchdown + brake_time, end - brake_depth * up, turned[1]),
        (touchdown + landing, end, still),
    ]
    if not push_depth > 0:
        del poses[1]
    if not brake_depth > 0:
        poses[-2:] = [(touchdown + landing, end, turned[1])]
    first = pin.log3(pin.Quaternion(robot.reference[3:7]).toRotationMatrix())
    return tuple(
        BaseWaypoint(time=time, position=position, turn=turn if i else first)
        for i, (time, position, turn) in enumerate(poses)
    )


def _push(robot: Robot, rise: float, speed: float, duration: float) -> tuple[float, float]:
    """Return time s and depth m of a push at constant acceleration up to ``speed`` m/s at the ``rise``, m."""
    if not speed > 0:
        return PUSH_PART * duration, 0.0
    way = max(sink_of(robot) + rise, LEAST_WAY * sink_of(robot))
    time = min(2 * way / speed, PUSH_PART * duration)
    return time, max(speed * time / 2 - rise, 0.0)


def _clipped(vector: np.ndarray, largest: float) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    return vector if size <= largest else vector * (largest / size)


def clearance(robot: Robot, flight: float) -> float:
    """Least height of feet in the middle of a flight of that duration, m."""
    return min(CLEARANCE_PART * robot.length, FREE_PART * gravity_of(robot.model) * flight**2 / 8)


def hips_and_knees(robot: Robot) -> tuple[str, ...]:
    """Frames of limb joints, without ankles: those standing at least twice the clearance over the ground."""
    ground = min(place[2] for place in contact_positions(robot, robot.reference).values())
    return tuple(
        joint
        for joint in leg_joints(robot)
        if frame_pose(robot, robot.reference, joint).translation[2]
        > ground + 2 * JOINT_CLEARANCE * robot.length
    )


def joint_clearance(robot: Robot) -> float:
    """Least height of hips and knees over the ground, m: joints are as thick as the feet."""
    return JOINT_CLEARANCE * robot.length + common.foot_radius(robot)


def above_ground(robot: Robot, heights: Mapping[str, float]) -> tuple[Term, ...]:
    """Hips and knees stay above the ground, whose ``heights`` in m are given by phase."""
    frames, keep = hips_and_knees(robot), joint_clearance(robot)
    return tuple(
        FramesAbove(frames=frames, height=height + keep, during=(phase,)) for phase, height in heights.items()
    )


def problem(
    name: str,
    takeoff: Takeoff,
    ends: tuple[np.ndarray, np.ndarray],
    durations: tuple[float, float, float],
    *,
    terrain: Terrain,
    turn: float = 0.0,
    goal: str = "effort",
    heights: tuple[float, float] = (0.0, 0.0),
    touchdown_rise: float | None = None,
    more: Sequence[Term] = (),
    **settings: Any,
) -> Problem:
    """A leap between two postures (nq,), from rest to rest; see `common.problem`.

    durations: of stance, flight and landing, s; free for goals other than effort. turn: rad to the
    left, in all. heights: of the ground at both ends, m. touchdown_rise: see `base_path`.
    """
    robot, (start, end) = takeoff.robot, ends
    schedule = common.hop_schedule(footholds_at(robot, end, terrain), durations)
    schedule = schedule if goal == "effort" else common.freed(schedule, FREE)
    path = base_path(takeoff, (start[:3], end[:3]), durations, turn, touchdown_rise)
    lift = clearance(robot, durations[1])
    before, after = heights
    below = above_ground(robot, {"stance": before, "flight": min(heights), "landing": after})
    return common.problem(
        name,
        robot,
        schedule,
        legged_guess(robot, schedule, path, start=start, terrain=terrain, clearance=lift),
        costs=goal_terms(goal, robot, schedule, effort=COSTS),
        terrain=terrain,
        clearance=lift,
        more=(*below, *more),
        end=end,
        initial_q=start,
        goal=goal,
        **settings,
    )
