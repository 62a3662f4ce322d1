"""Active contacts of a controller: what their forces may be, and how they may accelerate."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trajopt.control.robot_state import RobotState
from trajopt.dynamics.model_quantities import without_rolling
from trajopt.robot.friction import inscribed_rows, pressure_rows, yaw_rows

# Sides of the pyramid inscribed in Coulomb's cone: it holds back up to 8 % of the friction, four sides 29 %.
SIDES = 8
# An axis is too near to the normal to project if the square of its projection is less than this.
LEAST_PROJECTION = 1e-2


@dataclass(frozen=True, kw_only=True)
class ActiveContact:
    """A contact that transmits forces at a tick.

    Args:
        number: of the contact in the plan.
        frame: of the model, by name or index.
        dimension: 3 for a point, 6 for a sole.
        normal: out of the ground (3,), world.
        friction: Coulomb's coefficient.
        half_size: of a sole along its x and y axes, m.
        bilateral: whether it is held: any force, no cone.
        sliding: unit vector (3,) along which it slides, world; None where it sticks.
        most: largest normal force, N.
        lever: from where a ball that rolls touches to its centre (3,), m, world; None of others.
    """

    number: int
    frame: int | str
    dimension: int
    normal: np.ndarray
    friction: float
    half_size: tuple[float, float] = (0.0, 0.0)
    bilateral: bool = False
    sliding: np.ndarray | None = None
    most: float = math.inf
    lever: np.ndarray | None = None

    def force_rows(self, state: RobotState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (m, dimension) on the force in world axes, and their bounds (m,).

        A pyramid, the normal force in its bounds, and of a sole the wrench cone of its four corners (see
        `trajopt.robot.friction`). What slides transmits mu f_n against its way.
        """
        n, size = self.normal, self.dimension
        if self.bilateral:
            return np.zeros((0, size)), np.zeros(0), np.zeros(0)
        if size == 3 and self.sliding is None:
            return _pyramid(tuple(n.tolist()), self.friction, self.most)
        rotation = state.frame(self.frame).placement.rotation
        x, y = _tangents(n, rotation[:, 0], rotation[:, 1])
        if self.sliding is None:
            force, low, high = _cone(n, x, y, self.friction, self.most)
        else:
            along = self.sliding
            force = np.array([n, along + self.friction * n, cross(n, along)])
            low, high = np.zeros(3), np.array([self.most, 0.0, 0.0])
        if size == 3:
            return force, low, high
        axes = np.array([x, y, n])
        rows = _sole_rows(self.friction, self.half_size)
        moments = np.hstack([rows[:, :3] @ axes, rows[:, 3:] @ axes])
        whole = np.vstack([np.hstack([force, np.zeros((len(force), 3))]), moments])
        return whole, np.append(low, np.zeros(len(moments))), np.append(high, np.full(len(moments), np.inf))

    def jacobian(self, state: RobotState) -> np.ndarray:
        """Rows (dimension, nv) of its motion, and of what its force does; of a ball without what it rolls."""
        return self._held(state.frame(self.frame).jacobian)

    def _held(self, motion: np.ndarray) -> np.ndarray:
        """What a contact holds of motions (6, ...) of its frame."""
        return motion[: self.dimension] if self.lever is None else without_rolling(motion, self.lever)

    def motion_rows(self, state: RobotState, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m, nv) and values (m,) of an acceleration that takes the contact's velocity out.

        J a = -dJ v - damping J v; of what slides along the normal alone. ``damping`` in 1/s.
        """
        frame, jacobian = state.frame(self.frame), self.jacobian(state)
        value = -self._held(frame.drift) - damping * self._held(frame.velocity)
        if self.sliding is not None:
            rows = np.eye(self.dimension)[2:]  # of a sole with all its rotations
            rows[0, :3] = self.normal
            return rows @ jacobian, rows @ value
        return jacobian, value


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors (3,); NumPy's own takes 20 times as long."""
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _tangents(n: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors across a normal, the first along the projection of ``first``, or of ``second``."""
    x = first - n * (n @ first)
    if x @ x < LEAST_PROJECTION:
        x = second - n * (n @ second)
    x = x / math.sqrt(x @ x)
    return x, cross(n, x)


def _cone(
    n: np.ndarray, x: np.ndarray, y: np.ndarray, friction: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (9, 3) of a pyramid and the normal force, with their bounds."""
    rows = _pyramid_rows(friction) @ np.array([x, y, n])
    return rows, np.zeros(SIDES + 1), np.append(np.full(SIDES, np.inf), most)


@lru_cache(maxsize=256)
def _pyramid_rows(friction: float) -> np.ndarray:
    """Rows (9, 3) on the force along two axes and the normal."""
    force = np.eye(3)
    return np.array([*inscribed_rows(force, friction, SIDES), force[2]])


@lru_cache(maxsize=256)
def _pyramid(
    normal: tuple[float, float, float], friction: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of a point that sticks, whatever its frame's orientation."""
    n = np.array(normal)
    return _cone(n, *_tangents(n, *np.eye(3)[:2]), friction, most)


@lru_cache(maxsize=256)
def _sole_rows(friction: float, half_size: tuple[float, float]) -> np.ndarray:
    """Rows (14, 6) on a sole's wrench along its two axes and its normal, >= 0.

    Its centre of pressure, its moment about the normal, and what friction leaves of that. The moment is at
    most that of Coulomb's cones at the corners, mu f_n times half the diagonal.
    """
    force, moment = np.eye(6)[:3], np.eye(6)[3:]
    most = friction * math.hypot(*half_size) * force[2]
    turning = [most - moment[2], most + moment[2]]
    pressure = pressure_rows(force, moment, half_size)
    return np.array([*pressure, *turning, *yaw_rows(force, moment, half_size, friction)])
