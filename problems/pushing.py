"""How far legs extend and fold with the feet in place, and how fast they push a robot off the ground."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trajopt.dynamics import contact_jacobian, gravity_of
from trajopt.errors import InputError
from trajopt.robot import Posture, Robot, contact_poses, contact_targets, inverse_kinematics, require_moving

from .common import displaced

# Fraction of the legs' remaining extension that the guess uses at take-off and at touchdown.
EXTENSION_PART = 0.6
# Number of heights over which the work of a push is summed; tolerance of the extension over the length.
PUSH_SAMPLES, EXTENSION_ERROR = 24, 1e-3
# Least ballistic rise: this fraction of the robot's length, or the rise at this share of the take-off speed,
# whichever is less.
LEAST_FREE_RISE, LEAST_SHARE = 0.02, 0.75
# Ballistic rise, over the length, above which a faster take-off has no advantage.
ENOUGH_FREE = 0.05
# Torques or rates below this fraction of the others are rounding.
ROUNDING = 1e-9
# Largest error of inverse kinematics at feet that are reached, m.
REACHED = 1e-6
# In the guess the base sinks by at most this fraction of the robot's length below its height at the ends, and
# of the depth that joints allow with flat feet (humanoid ankles reach their limits early).
SINK_PART, OF_REACHABLE = 0.25, 0.7


@dataclass(frozen=True, kw_only=True, eq=False)
class Takeoff:
    """How fast a robot can leave the ground, feet in place: ``posture`` (nq,) with the base at ``rise`` m.

    ``speed`` m/s is the largest upward speed that the work of its torques in rising, and its joint rates at
    take-off, allow; `across` (forward, to the left, m/s) and ``turn`` rad/s (about the vertical) are those
    that the rates alone allow. Infinite without limits.
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
        """Key for comparison: free rise, up to a sufficient one, then the base's apex, m."""
        free = self.speed**2 / (2 * gravity_of(self.robot.model))
        return min(free, ENOUGH_FREE * self.robot.length), self.rise + free

    def _fastest(self, row: int) -> float:
        return _fastest(self.robot, self.posture, row)


def takeoff(robot: Robot, torque_limit: float | None = None) -> Takeoff:
    """The take-off with the highest apex of the base among the fast ones with some extension left.

    Legs that are nearly straight lift the base slowly. If no take-off is fast enough, the fastest one.

    Forces are taken to be vertical and the same at all feet, the base level. torque_limit: N m, for all
    joints. Raises InputError for a robot without gravity.
    """
    if not robot.model.gravity.linear.any():
        raise InputError(
            f"'{robot.name}' is without gravity: it would not come down again",
            "allowed: a model with gravity",
        )
    require_moving(robot, *(("velocity",) if torque_limit is not None else ()))
    limit = robot.torque_limit if torque_limit is None else np.full(robot.nu, torque_limit)
    gravity, sink = gravity_of(robot.model), sink_of(robot)
    heights = np.linspace(-sink, EXTENSION_PART * extension_left(robot), PUSH_SAMPLES)
    postures = [raised(robot, height).q for height in heights]
    excess = np.array([strongest(robot, q, limit) for q in postures]) - 1
    work = np.cumsum(np.append(0.0, np.diff(heights) * (excess[1:] + excess[:-1]) / 2))
    if heights[-1] < EXTENSION_ERROR * robot.length:
        raise InputError(
            f"'{robot.name}' cannot leave the ground: its legs are straight in the reference posture",
            "allowed: bent knees (trajopt robot says more)",
        )
    candidates = [
        Takeoff(
            robot=robot,
            posture=q,
            rise=float(height),
            speed=min(math.sqrt(2 * gravity * max(done, 0.0)), _fastest(robot, q, 2)),
        )
        for height, q, done in zip(heights, postures, work, strict=True)
        if height >= 0
    ]
    return max(reversed(candidates), key=lambda one: one.merit)  # the highest of equally good ones


def raised(robot: Robot, height: float) -> Posture:
    """Posture with the base ``height`` m over the reference and the feet in place, soles flat."""
    feet = contact_targets(robot, contact_poses(robot, robot.reference))
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
    """Return how far the level base moves up or down until inverse kinematics fail, m."""
    error = EXTENSION_ERROR * robot.length
    return largest(lambda way: raised(robot, sign * way).error < REACHED, robot.length, error)


def largest(holds: Callable[[float], bool], upper: float, error: float) -> float:
    """The largest value from 0 to ``upper`` at which a condition still ``holds``, by bisection."""
    lower = 0.0
    while upper - lower > error:
        middle = (lower + upper) / 2
        lower, upper = (middle, upper) if holds(middle) else (lower, middle)
    return lower


def _feet_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    return contact_jacobian(robot.model, q, [(contact.frame, contact.rows) for contact in robot.contacts])


def strongest(robot: Robot, q: np.ndarray, limit: np.ndarray | None) -> float:
    """Largest upward force at the feet in static balance, over the weight: tau = -J^T f within limits."""
    if limit is None:
        return math.inf
    upward = robot.weight / len(robot.contacts)
    force = np.concatenate([upward * (np.array(contact.rows) == 2) for contact in robot.contacts])
    torque = np.abs(_feet_jacobian(robot, q)[:, robot.actuated_rows].T @ force)
    return float(np.min(limit / np.maximum(torque, ROUNDING * robot.weight * robot.length)))


def _fastest(robot: Robot, q: np.ndarray, row: int) -> float:
    """Return the base's largest velocity along one row of its own, feet fixed: J_joints qd = -J_base v."""
    jacobian, joints = _feet_jacobian(robot, q), robot.actuated_rows
    rates = np.abs(np.linalg.lstsq(jacobian[:, joints], -jacobian[:, row], rcond=None)[0])
    unit = np.max(rates)
    return float(np.min(robot.velocity_limit[joints] / np.maximum(rates, ROUNDING * unit)))


def apex(takeoff: Takeoff, share: float, most: float) -> float:
    """Rise of the base, m, in a flight that begins with a share of the largest speed, ``most`` at most."""
    free = (share * takeoff.speed) ** 2 / (2 * gravity_of(takeoff.robot.model))
    return min(takeoff.rise + free, most)


def flight_time(takeoff: Takeoff, height: float, drop: float = 0.0) -> float:
    """Flight in s whose apex is ``height`` m over the base's start.

    At touchdown the base is ``drop`` m lower than at the `takeoff`.
    """
    gravity = gravity_of(takeoff.robot.model)
    least = min(LEAST_FREE_RISE * takeoff.robot.length, (LEAST_SHARE * takeoff.speed) ** 2 / (2 * gravity))
    up = max(height - takeoff.rise, least)
    return math.sqrt(2 * up / gravity) + math.sqrt(2 * max(up + drop, 0.0) / gravity)
