"""The ground as a robot feels it: a plane through the places where its feet last touched."""

from __future__ import annotations

import copy

import numpy as np

# Steepest plane that is believed, rise over run; beyond, feet stand on different things.
STEEPEST = 0.6
# Weight of a level plane against the feet, over the square of their distances.
LEVEL = 0.05
# Of a new place against what was believed, at each touch.
NEW = 0.1


class GroundEstimate:
    """Heights under feet, and the plane near them; level at height 0 before anything touches.

    Args:
        count: number of feet.
        length: of the robot, m.
    """

    def __init__(self, count: int, length: float) -> None:
        self.length = length
        self.places = np.zeros((count, 3))
        self.known = np.zeros(count, dtype=bool)
        self.point, self.slope = np.zeros(3), np.zeros(2)

    def copy(self) -> GroundEstimate:
        """The same estimate, which goes on apart."""
        return copy.deepcopy(self)

    def touch(self, places: np.ndarray, touching: np.ndarray) -> None:
        """Feet at ``places`` (nc, 3) m, world, of which those that touch (nc,) tell the ground."""
        self.places[touching] = places[touching]
        self.known |= touching
        if not self.known.any():
            return
        points = self.places[self.known]
        self.point = points.mean(axis=0)
        away = points - self.point
        pull = LEVEL * self.length**2 * np.eye(2)
        slope = np.linalg.solve(away[:, :2].T @ away[:, :2] + pull, away[:, :2].T @ away[:, 2])
        size = float(np.linalg.norm(slope))
        slope *= min(1.0, STEEPEST / size) if size > 0 else 1.0
        self.slope += NEW * (slope - self.slope)

    def height(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        """Height of the plane (...), m."""
        rise = self.slope[0] * (x - self.point[0]) + self.slope[1] * (y - self.point[1])
        return np.asarray(self.point[2] + rise)
