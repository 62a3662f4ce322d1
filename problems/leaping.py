"""What leaps of legged robots share: how far legs can still extend, the base's path, limits and ends.

A leap is a push from standing feet, a flight, and a landing that ends at rest. All of it follows from the
robot: its length l, the time sqrt(l / g), and the extension that its legs have left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import contact_jacobian, gravity_of
from trajopt.errors import InputError
from trajopt.problem.family import Parameter
from trajopt.reduced.base_path import BaseWaypoint
from trajopt.robot.kinematics import Posture, contact_poses, contact_positions, frame_pose, inverse_kinematics
from trajopt.robot.legs import leg_joints, quadruped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms import EffortLimits, FramesAbove, PositionLimits, Term, VelocityLimits, swing_clearance
from trajopt.terrain.terrain import Terrain
from trajopt_library import robots

from . import common

# Of the extension that legs have left, the guess uses this part at take-off and at touchdown.
EXTENSION_PART = 0.6
# The work of a push is summed over this many heights; the extension is found to this part of the length.
PUSH_SAMPLES, EXTENSION_ERROR = 24, 1e-3
# Any flight rises freely by this part of the robot's length at least, or what this share of the speed at
# take-off gives, whichever is less.
LEAST_FREE_RISE, LEAST_SHARE = 0.02, 0.75
# A take-off is fast enough if it rises freely by this part of the length: more is not bought with extension.
ENOUGH_FREE = 0.05
# A torque or rate this small against the others' is rounding.
ROUNDING = 1e-9
# Feet count as reached by inverse kinematics below this error, m.
REACHED = 1e-6
# In the guess the base sinks by at most this part of the robot's length under its height at the ends, and of
# what joints allow with the feet flat in place (ankles of humanoids end soon); it moves and turns by at most
# these while the feet stand: parts of the length, and rad.
SINK_PART, OF_REACHABLE = 0.25, 0.7
GROUND_PART = 0.2
GROUND_TURN = 0.35
# The guess pushes for at most this part of the stance, and brakes for at most this part of the landing.
PUSH_PART = 0.7
# Least height of a foot over the ground in mid flight: the lesser of a part of the robot's length and a part
# of what the base rises freely, so that slow legs need not be drawn up.
CLEARANCE_PART, FREE_PART = 0.1, 0.5
# Hips and knees stay this part of the robot's length above the ground.
JOINT_CLEARANCE = 0.15
# Price of accelerations, for smooth motions.
ACCELERATION = 2e-2


def quadruped(name: str) -> Robot:
    """The robot of that name, if it stands on four feet. Raises InputError."""
    robot = robots.load(name)
    quadruped_legs(robot)
    return robot


def natural_time(robot: Robot) -> float:
    """sqrt(l / g) in s, by which times of leaps are scaled."""
    return math.sqrt(robot.length / gravity_of(robot.model))


def displaced(
    robot: Robot, position: np.ndarray | tuple[float, float, float], yaw: float = 0.0
) -> np.ndarray:
    """Reference posture (nq,) with the base moved by ``position`` (3,) m and turned by ``yaw`` rad."""
    q = robot.reference.copy()
    q[:3] += position
    turn = pin.utils.rotate("z", yaw) @ pin.Quaternion(q[3:7]).toRotationMatrix()
    q[3:7] = pin.Quaternion(turn).coeffs()
    return q


@dataclass(frozen=True, kw_only=True, eq=False)
class Takeoff:
    """How fast a robot can leave the ground, feet in place: ``posture`` (nq,) with the base at ``rise`` m.

    ``speed`` m/s is the largest upward one that the work of its torques on the way up, and the rates of its
    joints there, allow; `across` (forward, to the left, m/s) and ``turn`` rad/s (about the vertical) are
    those that the rates alone allow. Infinite without limits.
    """

    robot: Robot
    posture: np.ndarray
    rise: float
    speed: float

    @property
    def across(self) -> tuple[float, float]:
        """Largest speeds of the base forward and to the left, m/s."""
        return self._fastest(0), self._fastest(1)

    @property
    def turn(self) -> float:
        """Largest rate about the vertical, rad/s."""
        return self._fastest(5)

    @property
    def merit(self) -> tuple[float, float]:
        """Free rise up to what is enough, and the base's apex, m: the first that is larger wins."""
        free = self.speed**2 / (2 * gravity_of(self.robot.model))
        return min(free, ENOUGH_FREE * self.robot.length), self.rise + free

    def _fastest(self, row: int) -> float:
        return _fastest(self.robot, self.posture, row)


def takeoff(robot: Robot, effort: float | None = None) -> Takeoff:
    """The take-off with the highest apex of the base among the fast ones with part of the extension left.

    Legs that are nearly straight lift the base slowly: a hop of stretching is none. Where none is fast enough
    the fastest.

    Forces are taken to be vertical and the same at all feet, the base level. effort: N m, for all joints.
    Raises InputError for a robot without gravity.
    """
    if not robot.model.gravity.linear.any():
        raise InputError(
            f"'{robot.name}' is without gravity: what leaps does not come down",
            "allowed: a model with gravity",
        )
    limit = robot.effort_limit if effort is None else np.full(robot.nu, effort)
    gravity, sink = gravity_of(robot.model), sink_of(robot)
    heights = np.linspace(-sink, EXTENSION_PART * extension_left(robot), PUSH_SAMPLES)
    postures = [raised(robot, height).q for height in heights]
    excess = np.array([strongest(robot, q, limit) for q in postures]) - 1
    work = np.cumsum(np.append(0.0, np.diff(heights) * (excess[1:] + excess[:-1]) / 2))
    best: Takeoff | None = None
    for height, q, done in zip(heights, postures, work, strict=True):
        if height < 0:
            continue
        speed = min(math.sqrt(2 * gravity * max(done, 0.0)), _fastest(robot, q, 2))
        found = Takeoff(robot=robot, posture=q, rise=float(height), speed=speed)
        if best is None or found.merit >= best.merit:
            best = found
    assert best is not None  # the last height is the extension, 0 or more
    if heights[-1] < EXTENSION_ERROR * robot.length:
        raise InputError(
            f"'{robot.name}' cannot leave the ground: its legs are straight in the reference posture",
            "allowed: bent knees (trajopt robot says more)",
        )
    return best


def raised(robot: Robot, height: float) -> Posture:
    """Posture with the base ``height`` m over the reference and the feet in place, soles flat."""
    poses = contact_poses(robot, robot.reference)
    feet = {
        c.frame: poses[c.name] if c.kind == "surface" else poses[c.name].translation for c in robot.contacts
    }
    return inverse_kinematics(robot, displaced(robot, (0.0, 0.0, height)), feet)


def extension_left(robot: Robot) -> float:
    """How much the base can rise over the reference posture with its feet in place, m."""
    return _way_left(robot, 1)


@lru_cache(maxsize=8)
def sink_left(robot: Robot) -> float:
    """How far the level base can sink under the reference with its feet in place, m."""
    return _way_left(robot, -1)


def sink_of(robot: Robot) -> float:
    """How far the base sinks for a push or a landing, m."""
    return min(SINK_PART * robot.length, OF_REACHABLE * sink_left(robot))


def _way_left(robot: Robot, sign: int) -> float:
    """Way of the level base up or down until inverse kinematics fails, m, by bisection."""
    lower, upper = 0.0, robot.length
    while upper - lower > EXTENSION_ERROR * robot.length:
        middle = (lower + upper) / 2
        reached = raised(robot, sign * middle).error < REACHED
        lower, upper = (middle, upper) if reached else (lower, middle)
    return lower


def _feet_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    return contact_jacobian(robot.model, q, [(contact.frame, contact.rows) for contact in robot.contacts])


def strongest(robot: Robot, q: np.ndarray, limit: np.ndarray | None) -> float:
    """Largest upward force at the feet in static balance, over the weight: tau = -J^T f within limits."""
    if limit is None:
        return math.inf
    upward = robot.weight / len(robot.contacts)
    force = np.concatenate([upward * (np.array(contact.rows) == 2) for contact in robot.contacts])
    torque = np.abs(_feet_jacobian(robot, q)[:, robot.n_unactuated :].T @ force)
    return float(np.min(limit / np.maximum(torque, ROUNDING * robot.weight * robot.length)))


def _fastest(robot: Robot, q: np.ndarray, row: int) -> float:
    """Largest velocity of the base along one row of its own, feet in place: J_joints qd = -J_base v."""
    jacobian, n = _feet_jacobian(robot, q), robot.n_unactuated
    rates = np.abs(np.linalg.lstsq(jacobian[:, n:], -jacobian[:, row], rcond=None)[0])
    unit = np.max(rates)
    return float(np.min(robot.velocity_limit[n:] / np.maximum(rates, ROUNDING * unit)))


def apex(takeoff: Takeoff, share: float, most: float) -> float:
    """Rise of the base, m, in a flight that begins with a share of the largest speed, ``most`` at most."""
    free = (share * takeoff.speed) ** 2 / (2 * gravity_of(takeoff.robot.model))
    return min(takeoff.rise + free, most)


def flight_time(takeoff: Takeoff, height: float, drop: float = 0.0) -> float:
    """Flight in s whose apex is ``height`` m over the base's start, landing ``drop`` m under that start.

    Take-off and touchdown with the legs as far extended as at the `takeoff`.
    """
    gravity = gravity_of(takeoff.robot.model)
    least = min(LEAST_FREE_RISE * takeoff.robot.length, (LEAST_SHARE * takeoff.speed) ** 2 / (2 * gravity))
    up = max(height - takeoff.rise, least)
    return math.sqrt(2 * up / gravity) + math.sqrt(2 * max(up + drop, 0.0) / gravity)


@dataclass(frozen=True, kw_only=True, eq=False)
class Leap:
    """A leap's base: from ``start`` to ``end`` (3,) m, turning by ``turn`` (3,) rad in all (world axes).

    ``durations``: of stance, flight and landing, s. ``rise``: of the base over ``start`` at take-off and over
    ``end`` at touchdown, m.
    """

    robot: Robot
    start: np.ndarray
    end: np.ndarray
    durations: tuple[float, float, float]
    rise: float
    turn: np.ndarray

    def waypoints(self) -> tuple[BaseWaypoint, ...]:
        """Rest, lowest point of the push, take-off, touchdown, lowest point of the landing, rest."""
        stance, flight, landing = self.durations
        takeoff, touchdown = stance, stance + flight
        gravity, climb = gravity_of(self.robot.model), float(self.end[2] - self.start[2])
        push = self._push(climb / flight + gravity * flight / 2, stance)
        brake = self._push(gravity * flight / 2 - climb / flight, landing)
        across = (self.end - self.start) * [1, 1, 0]
        largest = GROUND_PART * self.robot.length
        moved = [_clipped(part * across, largest) for part in self._shares(push[0], brake[0])]
        turned = [_clipped(part * self.turn, GROUND_TURN) for part in self._shares(push[0], brake[0])]
        up, still = np.array([0.0, 0.0, 1.0]), np.zeros(3)
        poses = [
            (0.0, self.start, still),
            (takeoff - push[0], self.start - push[1] * up, still),
            (takeoff, self.start + moved[0] + self.rise * up, turned[0]),
            (touchdown, self.end - moved[1] + self.rise * up, self.turn - turned[0] - turned[1]),
            (touchdown + brake[0], self.end - brake[1] * up, turned[1]),
            (touchdown + landing, self.end, still),
        ]
        if not push[1] > 0:
            del poses[1]
        if not brake[1] > 0:
            poses[-2:] = [(touchdown + landing, self.end, turned[1])]
        first = pin.log3(pin.Quaternion(self.robot.reference[3:7]).toRotationMatrix())
        return tuple(
            BaseWaypoint(time=time, position=position, turn=turn if i else first)
            for i, (time, position, turn) in enumerate(poses)
        )

    def _push(self, speed: float, duration: float) -> tuple[float, float]:
        """Time s and depth m of a push of constant acceleration up to ``speed`` m/s at the rise."""
        if not speed > 0:
            return PUSH_PART * duration, 0.0
        deepest = 2 * (sink_of(self.robot) + self.rise) / speed
        time = min(deepest, PUSH_PART * duration)
        return time, max(speed * time / 2 - self.rise, 0.0)

    def _shares(self, push: float, brake: float) -> tuple[float, float]:
        """Parts of the way that are gone before take-off and after touchdown, at constant acceleration."""
        whole = push / 2 + self.durations[1] + brake / 2
        return push / 2 / whole, brake / 2 / whole


def _clipped(vector: np.ndarray, largest: float) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    return vector if size <= largest else vector * (largest / size)


def clearance(robot: Robot, flight: float) -> float:
    """Least height of feet in the middle of a flight of that duration, m."""
    return min(CLEARANCE_PART * robot.length, FREE_PART * gravity_of(robot.model) * flight**2 / 8)


def leap_terms(
    robot: Robot,
    schedule: Schedule,
    terrain: Terrain,
    guess: Motion,
    *,
    effort: float | None,
    clearance: float,
    costs: tuple[Term, ...] | None = None,
) -> tuple[Term, ...]:
    """Costs and limits of every leap: torques and rates, friction, feet clear of the ground in flight.

    costs: default those of least effort.
    """
    return (
        *(common.legged_costs(acceleration=ACCELERATION) if costs is None else costs),
        EffortLimits(limit=None if effort is None else np.full(robot.nu, effort)),
        PositionLimits(),
        VelocityLimits(),
        *common.contact_cones(robot),
        *swing_clearance(robot, schedule, terrain, height=clearance, guess=guess),
    )


def hips_and_knees(robot: Robot) -> tuple[str, ...]:
    """Frames of the joints of limbs, but for ankles: those that stand twice the clearance over the ground."""
    ground = min(place[2] for place in contact_positions(robot, robot.reference).values())
    return tuple(
        joint
        for joint in leg_joints(robot)
        if frame_pose(robot, robot.reference, joint).translation[2]
        > ground + 2 * JOINT_CLEARANCE * robot.length
    )


def above_ground(robot: Robot, heights: Mapping[str, float]) -> tuple[Term, ...]:
    """Hips and knees stay above the ground, whose ``heights`` in m are given by phase."""
    frames, keep = hips_and_knees(robot), JOINT_CLEARANCE * robot.length
    return tuple(
        FramesAbove(frames=frames, height=height + keep, phases=(phase,)) for phase, height in heights.items()
    )


def scaled(name: str, unit: str, within: common.Range, meaning: str) -> Parameter:
    """A parameter whose default is derived from the robot."""
    return Parameter(name=name, default=None, unit=unit, lower=within[0], upper=within[1], meaning=meaning)
