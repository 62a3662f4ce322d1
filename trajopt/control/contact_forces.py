"""Active contacts of a controller: what their forces may be, and how they may accelerate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajopt.control.robot_state import RobotState

# Faces of the pyramid inscribed in Coulomb's cone: it holds back up to 8 % of the friction, four faces 29 %.
FACES = 8
ANGLES = 2.0 * math.pi / FACES * np.arange(FACES)
INSCRIBED = math.cos(math.pi / FACES)


@dataclass(frozen=True, kw_only=True)
class ActiveContact:
    """A contact that transmits forces at a tick.

    Args:
        number: of the contact in the plan.
        frame: of the model, by index.
        dimension: 3 for a point, 6 for a sole.
        normal: out of the ground (3,), world.
        friction: Coulomb's coefficient.
        half_size: of a sole along its x and y axes, m.
        bilateral: whether it is held: any force, no cone.
        sliding: unit vector (3,) along which it slides, world; None where it sticks.
        most: largest normal force, N.
    """

    number: int
    frame: int
    dimension: int
    normal: np.ndarray
    friction: float
    half_size: tuple[float, float] = (0.0, 0.0)
    bilateral: bool = False
    sliding: np.ndarray | None = None
    most: float = math.inf

    def force_rows(self, state: RobotState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (m, dimension) on the force in world axes, and their bounds (m,).

        A pyramid, the normal force in its bounds, and of a sole the wrench cone of its four corners: centre
        of pressure within the rectangle, and moment about the normal (Caron, Pham and Nakamura, ICRA 2015,
        eq. 13 to 18; at most that of Coulomb's cones, mu f_n times half the diagonal). What slides transmits
        mu f_n against its way.
        """
        n, size = self.normal, self.dimension
        if self.bilateral:
            return np.zeros((0, size)), np.zeros(0), np.zeros(0)
        axes = state.frame(self.frame).placement.rotation
        x = axes[:, 0] - n * (n @ axes[:, 0])
        if np.linalg.norm(x) < 0.1:
            x = axes[:, 1] - n * (n @ axes[:, 1])
        x = x / np.linalg.norm(x)
        y = np.cross(n, x)
        rows: list[np.ndarray] = []
        if self.sliding is None:
            across = np.cos(ANGLES)[:, None] * x + np.sin(ANGLES)[:, None] * y
            rows += list(INSCRIBED * self.friction * n - across)
        rows.append(n)
        force = np.array(rows)
        low, high = np.zeros(len(force)), np.full(len(force), np.inf)
        high[-1] = self.most
        if self.sliding is not None:
            along = self.sliding
            across = np.cross(n, along)
            force = np.vstack([force, along + self.friction * n, across])
            low, high = np.append(low, [0.0, 0.0]), np.append(high, [0.0, 0.0])
        if size == 3:
            return force, low, high
        moments = self._moments(x, y)
        whole = np.vstack([np.hstack([force, np.zeros((len(force), 3))]), moments])
        return whole, np.append(low, np.zeros(len(moments))), np.append(high, np.full(len(moments), np.inf))

    def _moments(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Rows (m, 6), >= 0, of a sole's wrench with axes x, y along its sides."""
        n, mu, (length, width) = self.normal, self.friction, self.half_size
        rows = [np.concatenate([width * n, sign * x]) for sign in (-1, 1)]
        rows += [np.concatenate([length * n, sign * y]) for sign in (-1, 1)]
        rows += [np.concatenate([mu * math.hypot(length, width) * n, sign * n]) for sign in (-1, 1)]
        for turn in (-1, 1):
            for first in (-1, 1):
                for second in (-1, 1):
                    force = mu * (length + width) * n - first * width * x - second * length * y
                    moment = turn * (n + mu * (first * x + second * y))
                    rows.append(np.concatenate([force, moment]))
        return np.array(rows)

    def motion_rows(self, state: RobotState, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m, nv) and values (m,) of an acceleration that takes the contact's velocity out.

        J a = -dJ v - damping J v; of what slides along the normal alone. ``damping`` in 1/s.
        """
        own = state.frame(self.frame)
        jacobian = own.jacobian[: self.dimension]
        value = -own.drift[: self.dimension] - damping * own.velocity[: self.dimension]
        if self.sliding is not None:
            rows = self.normal[None] if self.dimension == 3 else _without_sliding(self.normal)
            return rows @ jacobian, rows @ value
        return jacobian, value


def _without_sliding(normal: np.ndarray) -> np.ndarray:
    """Rows (4, 6) of a sole that slides: along the normal, and all rotations."""
    return np.block([[normal[None], np.zeros((1, 3))], [np.zeros((3, 3)), np.eye(3)]])
