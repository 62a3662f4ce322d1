"""Distances between two links with few joints between them, as polynomials of these joints' angles.

Links close together in a chain turn about axes that pass through both. Their distance changes by millimetres
over a radian, and the normal between their nearest points turns with the joints. A plane carried by one link
is a very loose lower bound of such a distance: it excludes most of the joints' range. But the distance is a
function of only a few angles. Around the motion it is fitted by a cubic polynomial, by least squares to
Coal's distances, and shifted to the exact value on the motion. So rows have the distance's exact value where
they are laid, and its slope over some tenths of a radian. They are not bounds of the distance, so a motion
that satisfies them is checked again.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from trajopt.collision.near import CollisionScene, ShapePair, joints_between

# Largest number of joints between two links whose distance is fitted, and the polynomial's total degree.
MOST_JOINTS, DEGREE = 3, 3
# Spacing of the lattice around whose points distances are fitted, and range of a fit to either side, rad: the
# fit around the nearest point is valid beyond the motion by more than half the spacing.
STEP, REACH = 0.2, 0.35
# Number of samples along each axis, by the number of joints.
SAMPLES = {1: 17, 2: 9, 3: 7}


@dataclass(frozen=True, eq=False)
class JointDistances:
    """Fits of the distances of a scene's pairs, computed once for each cell of the lattice."""

    scene: CollisionScene
    _fits: dict[tuple[ShapePair, tuple[int, ...]], np.ndarray] = field(default_factory=dict, init=False)
    _pairs: dict[ShapePair, CollisionScene] = field(default_factory=dict, init=False)
    _joints: dict[ShapePair, tuple[int, ...]] = field(default_factory=dict, init=False)

    def joints(self, pair: ShapePair) -> tuple[int, ...]:
        """Return indices of the joints between two links; empty if too many, or if not all are revolute."""
        if pair not in self._joints:
            self._joints[pair] = self._between(pair)
        return self._joints[pair]

    def rows(self, pair: ShapePair, configurations: np.ndarray, margin: float) -> np.ndarray:
        """Return parameters (K, n + m) of rows at configurations (K, nq): centre (n,) rad, coefficients (m,).

        The polynomial in the angles minus the centre is the distance minus ``margin`` in m, see `monomials`.
        """
        q = np.atleast_2d(configurations)
        angles = q[:, self._columns(pair)]
        cells = np.round(angles / STEP).astype(int)
        self._fit(pair, q[0], list(np.unique(cells, axis=0)))
        coefficients = np.array([self._fits[pair, tuple(cell.tolist())] for cell in cells])
        rows = np.hstack([STEP * cells, coefficients])
        rows[:, angles.shape[1]] += self.distances(pair, q) - margin - self.values(pair, q, rows)
        return rows

    def values(self, pair: ShapePair, configurations: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return values (K,) m of rows (K, n + m) at configurations (K, nq)."""
        columns = self._columns(pair)
        angles = configurations[:, columns] - rows[:, : len(columns)]
        return np.asarray(np.sum(powers(angles) * rows[:, len(columns) :], axis=1))

    def _fit(self, pair: ShapePair, q: np.ndarray, cells: Sequence[np.ndarray]) -> None:
        """Fit the ``cells`` that are new; ``q`` (nq,) sets all other joints."""
        new = [cell for cell in cells if (pair, tuple(cell.tolist())) not in self._fits]
        if not new:
            return
        columns = self._columns(pair)
        axis = np.linspace(-REACH, REACH, SAMPLES[len(columns)])
        around = np.array(list(itertools.product(axis, repeat=len(columns))))
        sampled = np.tile(q, (len(new), len(around), 1))
        sampled[:, :, columns] = STEP * np.array(new)[:, None] + around
        distances = self.distances(pair, sampled.reshape(-1, len(q))).reshape(len(new), -1)
        fitted = np.linalg.lstsq(powers(around), distances.T, rcond=None)[0].T
        self._fits.update({(pair, tuple(c.tolist())): fit for c, fit in zip(new, fitted, strict=True)})

    def distances(self, pair: ShapePair, configurations: np.ndarray) -> np.ndarray:
        """Return signed distances (K,) m of a pair at configurations (K, nq)."""
        if pair not in self._pairs:
            shapes = tuple(shape for shape in self.scene.shapes if shape.name in pair)
            self._pairs[pair] = CollisionScene(model=self.scene.model, shapes=shapes, self_pairs=(pair,))
        return self._pairs[pair].distances(configurations)[:, 0]

    def _columns(self, pair: ShapePair) -> list[int]:
        return [int(self.scene.model.joints[joint].idx_q) for joint in self.joints(pair)]

    def _between(self, pair: ShapePair) -> tuple[int, ...]:
        model, shapes = self.scene.model, {shape.name: shape for shape in self.scene.shapes}
        if not set(pair) <= set(shapes):  # an obstacle, or the ground
            return ()
        between = joints_between(model, *(shapes[name].frame for name in pair))
        joints = [model.joints[joint] for joint in between]
        turn = all(joint.nq == 1 and joint.shortname().startswith("JointModelR") for joint in joints)
        return between if turn and len(between) <= MOST_JOINTS else ()


@cache
def monomials(count: int) -> tuple[tuple[int, ...], ...]:
    """Return the exponents of all monomials in ``count`` variables up to `DEGREE`, the constant first."""
    return tuple(e for e in itertools.product(range(DEGREE + 1), repeat=count) if sum(e) <= DEGREE)


def powers(points: np.ndarray) -> np.ndarray:
    """Return the monomials (K, m) at points (K, n)."""
    return np.prod(points[:, None, :] ** np.array(monomials(points.shape[1])), axis=2)
