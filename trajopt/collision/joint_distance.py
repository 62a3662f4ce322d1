"""Distances of two links that few joints lie between, as polynomials of these joints' angles.

Links next to each other in a chain turn about axes that pass through both: their distance changes by
millimetres over a radian, and the normal along which they are nearest turns with the joints. A plane that one
of them carries bounds such a distance from far below: it cuts off most of what the joints may do. But the
distance is a function of two or three angles alone. Around the motion it is fitted by a cubic, by least
squares to Coal's distances, and moved to the exact value on the motion. So rows have the distance's value
where they are laid and its slope over some tenths of a radian; they are no bound of it, and a motion that
satisfies them is looked at again.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from trajopt.collision.near import CollisionScene, ShapePair, joints_between

# Most joints between two links whose distance is fitted, and the polynomial's total degree.
MOST_JOINTS, DEGREE = 3, 3
# Fits are made around the points of a lattice, rad, over so much to both sides: that of the nearest one is
# good beyond the motion by more than half of the lattice's step.
STEP, REACH = 0.2, 0.35
# Samples along each axis, by the number of joints.
SAMPLES = {1: 17, 2: 9, 3: 7}


@dataclass(frozen=True, eq=False)
class JointDistances:
    """Fits of the distances of a scene's pairs, made once for each cell of the lattice."""

    scene: CollisionScene
    _fits: dict[tuple[ShapePair, tuple[int, ...]], np.ndarray] = field(default_factory=dict, init=False)
    _pairs: dict[ShapePair, CollisionScene] = field(default_factory=dict, init=False)
    _joints: dict[ShapePair, tuple[int, ...]] = field(default_factory=dict, init=False)

    def joints(self, pair: ShapePair) -> tuple[int, ...]:
        """Joints between two links, by index; empty if these are too many, or others than revolute ones."""
        if pair not in self._joints:
            self._joints[pair] = self._between(pair)
        return self._joints[pair]

    def rows(self, pair: ShapePair, configurations: np.ndarray, margin: float) -> np.ndarray:
        """Parameters (K, n + m) of rows at configurations (K, nq): centre (n,) rad, coefficients (m,) m.

        The polynomial of the angles less the centre is the distance less ``margin``, see `monomials`.
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
        """Values (K,) m of rows (K, n + m) at configurations (K, nq)."""
        columns = self._columns(pair)
        angles = configurations[:, columns] - rows[:, : len(columns)]
        return np.asarray(np.sum(powers(angles) * rows[:, len(columns) :], axis=1))

    def _fit(self, pair: ShapePair, q: np.ndarray, cells: Sequence[np.ndarray]) -> None:
        """Fit what is new of ``cells``; ``q`` (nq,) is a configuration for all other joints."""
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
        """Signed distances (K,) m of a pair at configurations (K, nq)."""
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
    """Exponents of the monomials in ``count`` variables, up to `DEGREE`; the constant first."""
    return tuple(e for e in itertools.product(range(DEGREE + 1), repeat=count) if sum(e) <= DEGREE)


def powers(points: np.ndarray) -> np.ndarray:
    """Monomials (K, m) at points (K, n)."""
    return np.prod(points[:, None, :] ** np.array(monomials(points.shape[1])), axis=2)
