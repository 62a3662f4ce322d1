"""Active contacts of a controller: constraints on their forces and accelerations."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trajopt.control.robot_state import RobotState
from trajopt.dynamics.model_quantities import without_rolling
from trajopt.robot.friction import inscribed_rows, pressure_rows, yaw_rows

# Sides of the pyramid inscribed in Coulomb's cone: eight give away up to 8 % of the friction, four 29 %.
SIDES = 8
# Least squared length of an axis projected across the normal; a shorter one has no reliable direction.
LEAST_PROJECTION = 1e-2


@dataclass(frozen=True, kw_only=True)
class ActiveContact:
    """A contact that transmits forces at a tick.

    Args:
        number: index of the contact in the plan.
        frame: frame of the model, by name or index.
        dimension: 3 for a point, 6 for a sole.
        normal: unit vector out of the ground (3,), world.
        friction: Coulomb's coefficient.
        half_size: half sizes of a sole along its x and y axes, m.
        bilateral: whether the contact is held and may transmit any force, without a cone.
        sliding: unit vector (3,) along which the contact slides, world; None if it sticks.
        most: largest normal force, N.
        lever: vector (3,) from the touching point of a rolling ball to its centre, m, world; None for others.
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
        """Rows (m, dimension) on the force in world axes, and their lower and upper bounds (m,).

        They are a friction pyramid, bounds of the normal force and, for a sole, the wrench cone of its four
        corners (see `trajopt.robot.friction`). A sliding contact transmits mu f_n against its direction.
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
        """Jacobian (dimension, nv) of the contact's motion and force; of a ball without its rolling."""
        return self._held(state.frame(self.frame).jacobian)

    def _held(self, motion: np.ndarray) -> np.ndarray:
        """The components (dimension, ...) of its frame's motions (6, ...) that the contact prevents."""
        return motion[: self.dimension] if self.lever is None else without_rolling(motion, self.lever)

    def motion_rows(self, state: RobotState, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m, nv) and values (m,) of accelerations that bring the contact's velocity to zero.

        J a = -dJ v - damping J v, with ``damping`` in 1/s; for a sliding contact only along the normal.
        """
        frame, jacobian = state.frame(self.frame), self.jacobian(state)
        value = -self._held(frame.drift) - damping * self._held(frame.velocity)
        if self.sliding is not None:
            rows = np.eye(self.dimension)[2:]  # of a sole with all its rotations
            rows[0, :3] = self.normal
            return rows @ jacobian, rows @ value
        return jacobian, value


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors (3,), 20 times as fast as NumPy's."""
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _tangents(n: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors across a normal, the first along the projection of ``first`` or else of ``second``."""
    x = first - n * (n @ first)
    if x @ x < LEAST_PROJECTION:
        x = second - n * (n @ second)
    x = x / math.sqrt(x @ x)
    return x, cross(n, x)


def _cone(
    n: np.ndarray, x: np.ndarray, y: np.ndarray, friction: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (9, 3) of the pyramid and the normal force, and their bounds (9,)."""
    rows = _pyramid_rows(friction) @ np.array([x, y, n])
    return rows, np.zeros(SIDES + 1), np.append(np.full(SIDES, np.inf), most)


@lru_cache(maxsize=256)
def _pyramid_rows(friction: float) -> np.ndarray:
    """Rows (9, 3) on the components of the force along two tangents and the normal."""
    force = np.eye(3)
    return np.array([*inscribed_rows(force, friction, SIDES), force[2]])


@lru_cache(maxsize=256)
def _pyramid(
    normal: tuple[float, float, float], friction: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and bounds for a point that sticks; they do not depend on its frame's orientation."""
    n = np.array(normal)
    return _cone(n, *_tangents(n, *np.eye(3)[:2]), friction, most)


@lru_cache(maxsize=256)
def _sole_rows(friction: float, half_size: tuple[float, float]) -> np.ndarray:
    """Rows (14, 6) on a sole's wrench in its two axes and its normal, >= 0.

    They bound the centre of pressure, the moment about the normal, and that moment together with friction. It
    is at most the moment of Coulomb's cones at the corners, mu f_n times half the diagonal.
    """
    force, moment = np.eye(6)[:3], np.eye(6)[3:]
    most = friction * math.hypot(*half_size) * force[2]
    turning = [most - moment[2], most + moment[2]]
    pressure = pressure_rows(force, moment, half_size)
    return np.array([*pressure, *turning, *yaw_rows(force, moment, half_size, friction)])
