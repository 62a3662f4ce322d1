"""An estimate of the ground: a plane through the points where the feet last touched."""

from __future__ import annotations

import copy

import numpy as np

# Largest slope of the plane, rise over run; steeper ones mean that the feet stand on different objects.
STEEPEST = 0.6
# Weight of a level plane in the least-squares fit, over the square of the robot's length.
LEVEL = 0.05
# Share of the new fit in the estimated slope, at each update.
NEW = 0.1


class GroundEstimate:
    """Heights under the feet and the plane near them; level at height 0 before a foot touches.

    Args:
        count: number of feet.
        length: length of the robot, m.
    """

    def __init__(self, count: int, length: float) -> None:
        self.length = length
        self.places = np.zeros((count, 3))
        self.known = np.zeros(count, dtype=bool)
        self.point, self.slope = np.zeros(3), np.zeros(2)

    def copy(self) -> GroundEstimate:
        """An independent copy of the estimate."""
        return copy.deepcopy(self)

    def touch(self, places: np.ndarray, touching: np.ndarray) -> None:
        """Update the plane with the ``touching`` (count,) feet, at ``places`` (count, 3), m, world."""
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
        """Height of the plane (...) at x and y (...), m."""
        rise = self.slope[0] * (x - self.point[0]) + self.slope[1] * (y - self.point[1])
        return np.asarray(self.point[2] + rise)
