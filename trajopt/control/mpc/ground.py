"""The ground of a controller: a plane through the points where the feet last touched, or known terrain."""

from __future__ import annotations

import copy

import numpy as np
from typing_extensions import override

from trajopt.terrain.piecewise import PiecewiseTerrain

# Largest slope of the plane, rise over run; steeper ones mean that the feet stand on different objects.
STEEPEST = 0.6
# Weight of a level plane in the least-squares fit, over the square of the robot's length.
LEVEL = 0.05
# Share of the new fit in the estimated slope, at each update.
NEW = 0.1
# Distance of footholds from edges of known ground, and farthest place that replaces a foothold, over the
# robot's length.
MARGIN, SEARCH = 0.12, 0.6
# Factor on a foot's level error at the end of a swing on unknown ground, relative to the error of its height.
PULL = 0.2
# Part of a swing in which a foot rises to the top of its way, in which it descends from it, and at either end
# in which it stays; number of places of the way.
SLANT, EDGE, ALONG = 0.4, 0.1, 20
# Number of rings, a margin apart, in which the leg above a foothold has room.
RINGS = 4
# Directions of a ring, and places in a unit disc.
RING = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4])
DISC = np.concatenate([[[0.0, 0.0]], *(r * RING for r in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0))])


class GroundEstimate:
    """Heights under the feet and the plane near them; level at height 0 before a foot touches.

    Args:
        count: number of feet.
        length: length of the robot, m.
    """

    mapped = False

    def __init__(self, count: int, length: float) -> None:
        self.length = length
        self.places = np.zeros((count, 3))
        self.known = np.zeros(count, dtype=bool)
        self.point, self.slope = np.zeros(3), np.zeros(2)

    def copy(self) -> GroundEstimate:
        """An independent copy of the estimate."""
        twin = copy.copy(self)
        twin.places, twin.known, twin.slope = self.places.copy(), self.known.copy(), self.slope.copy()
        return twin

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

    def foothold(self, place: np.ndarray) -> np.ndarray:
        """The foothold (3,) for a foot that should land at a place (2,), m."""
        return np.append(place, self.height(*place))

    def swing(self, s: np.ndarray, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Path (n, 3) on the ground of a foot from start to goal (3,) at fractions s (n,) of its swing.

        The second array (n,) has factors on its level error, relative to that of its height.
        """
        path = np.tile(goal, (len(s), 1))
        path[:, 2] += (1 - s) * (start[2] - goal[2])
        return path, PULL * s


class KnownGround(GroundEstimate):
    """Ground that the controller knows: footholds keep clear of edges, and the base follows a mean height.

    Args:
        count: number of feet.
        length: length of the robot, m.
        around: radius of the disc over which heights are averaged for the base, m.
        terrain: the ground.
    """

    mapped = True

    def __init__(self, count: int, length: float, around: float, terrain: PiecewiseTerrain) -> None:
        super().__init__(count, length)
        self.terrain = terrain
        self._disc = around * DISC
        self._margin, self._candidates = MARGIN * length, SEARCH * length * DISC
        self._near = self._margin * np.concatenate([number * RING for number in range(1, RINGS + 1)])

    @override
    def touch(self, places: np.ndarray, touching: np.ndarray) -> None:
        self.places[touching] = places[touching]
        x, y = places[:, :2].mean(axis=0)
        self.slope = self._plane(x, y)[1]

    @override
    def height(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        return self._plane(x, y)[0]

    def _plane(self, x: np.ndarray | float, y: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Mean height (...) of the ground around x, y (...), m, and slopes (..., 2); holes count as flat."""
        z = self._heights(np.stack([x, y], axis=-1), self._disc)
        known = np.isfinite(z)
        mean = np.where(known, z, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
        away = np.where(known, z, mean[..., None]) - mean[..., None]
        return mean, away @ self._disc / (self._disc[:, 0] ** 2).sum()

    def _heights(self, places: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """Heights (..., n) at places (..., 2) moved by offsets (n, 2), m."""
        return self.terrain.height(*np.moveaxis(places[..., None, :] + offsets, -1, 0))

    @override
    def swing(self, s: np.ndarray, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The path rises to the highest ground below it before it leaves, and descends behind it."""
        way = start[:2] + np.linspace(0.0, 1.0, ALONG)[:, None] * (goal[:2] - start[:2])
        top = max(float(self.terrain.height(*way.T).max()), start[2], goal[2])
        parts = np.clip([s / SLANT, (1 - s) / SLANT, (s - EDGE) / (1 - 2 * EDGE)], 0.0, 1.0)
        rises, falls, moves = parts**2 * (3 - 2 * parts)
        heights = np.minimum(start[2] + (top - start[2]) * rises, goal[2] + (top - goal[2]) * falls)
        return np.column_stack([start[:2] + moves[:, None] * (goal - start)[:2], heights]), np.ones(len(s))

    @override
    def foothold(self, place: np.ndarray) -> np.ndarray:
        """The nearest place without edges within a margin, and with a free cone of 45 degrees beyond it."""
        places = place + self._candidates
        missing = self._missing(places[:1])
        if missing[0] > 0:
            missing = self._missing(places)
            place = places[int(np.lexsort((np.linalg.norm(self._candidates, axis=1), missing))[0])]
        return np.append(place, self.terrain.height(*place))

    def _missing(self, places: np.ndarray) -> np.ndarray:
        """Height (n,), m, by which ground around places (n, 2) is too low or too high; 0 where it is not."""
        z = self._heights(places, self._near)
        own = self.terrain.height(*places.T)[:, None]
        with np.errstate(invalid="ignore"):  # holes
            rises = np.where(np.isfinite(own), z - own, np.inf).reshape(len(places), -1, len(RING))
        even = STEEPEST * self._margin
        beyond = rises.max(axis=-1) - np.maximum(even, self._margin * np.arange(rises.shape[1]))
        low = -even - rises[:, 0].min(axis=-1)
        return np.round(np.maximum(np.maximum(beyond.max(axis=-1), low), 0.0), 3)
