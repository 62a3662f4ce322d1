"""Signed distances and nearest points of pairs of moving shapes, by Coal."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.dynamics.joint_placements import Placements

# Every so many configurations Coal gives a normal that bounds the distances of those around it.
STRIDE = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """Where two bodies are nearest, or the shortest way out of each other.

    normal: (3,) world, unit, from the second body to the first. distance: signed, m: the least height of the
    first body along the normal minus the greatest of the second, exactly: where faces touch, Coal's normal is
    exact to 1e-5 and so is this. first_point, second_point: (3,) m, world, on the surfaces, first_point =
    second_point + distance normal to the same accuracy.
    """

    distance: float
    normal: np.ndarray
    first_point: np.ndarray
    second_point: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class CoalBody:
    """All within ``radius`` m of the hull of ``points`` (n, 3) on a frame: Coal's body, placed in it."""

    solid: Any
    place: pin.SE3
    points: np.ndarray
    radius: float


@dataclass(frozen=True)
class CoalPairs:
    """Bodies on frames; a pair of them is given by two indices."""

    bodies: list[CoalBody]
    _functions: dict[tuple[int, int], Any] = field(default_factory=dict, init=False)

    def distances(
        self, pair: tuple[int, int], first: Placements, second: Placements, within: float = np.inf
    ) -> np.ndarray:
        """Signed distances (k,) m of a pair whose frames are at these placements (k, 3, 3), (k, 3).

        Of bodies farther apart than ``within`` m it may be a lower bound instead, which is > ``within``:
        neighbours in time have almost the same normal, and how far apart the bodies are along it is a bound.
        """
        count = len(first[0])
        found, leaders = np.empty(count), np.arange(0, count, STRIDE)
        found[leaders], normals = self._measured(pair, first, second, leaders)
        rest = np.flatnonzero(np.arange(count) % STRIDE)
        hint = np.minimum((rest + STRIDE // 2) // STRIDE, len(leaders) - 1)
        held = np.einsum("kji,kj->ki", first[0][leaders], normals)[hint]
        found[rest] = self._apart(
            pair, (first[0][rest], first[1][rest]), (second[0][rest], second[1][rest]), held
        )
        near = rest[~(found[rest] > within)]
        found[near], _ = self._measured(pair, first, second, near)
        return found

    def _apart(
        self, pair: tuple[int, int], first: Placements, second: Placements, normals: np.ndarray
    ) -> np.ndarray:
        """How far apart (k,) m bodies are along ``normals`` (k, 3) in the axes of the first's frame."""
        one, other = (self.bodies[index] for index in pair)
        world = np.einsum("kij,kj->ki", first[0], normals)
        back = -np.einsum("kji,kj->ki", second[0], world)
        between = np.sum((first[1] - second[1]) * world, axis=1) - one.radius - other.radius
        return np.asarray(
            between + (normals @ one.points.T).min(axis=1) + (back @ other.points.T).min(axis=1)
        )

    def _measured(
        self, pair: tuple[int, int], first: Placements, second: Placements, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,) m and normals (n, 3) from the second to the first, world, of some rows."""
        measure, request, result = self._function(pair), coal.DistanceRequest(), coal.DistanceResult()
        one, other = coal.Transform3s(), coal.Transform3s()
        places = [
            self._placed(index, (frame[0][rows], frame[1][rows]))
            for index, frame in zip(pair, (first, second), strict=True)
        ]
        found, normals = np.empty(len(rows)), np.empty((len(rows), 3))
        for k, (a, b, c, d) in enumerate(zip(*places[0], *places[1], strict=True)):
            one.setTransform(a, b)
            other.setTransform(c, d)
            result.clear()
            found[k] = measure(one, other, request, result)
            normals[k] = result.normal
        return found, -normals

    def witness(self, pair: tuple[int, int], first: Placements, second: Placements) -> Witness:
        """Nearest points of a pair whose frames are at one placement (1, 3, 3), (1, 3) each."""
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        places = [self._placed(index, frame) for index, frame in zip(pair, (first, second), strict=True)]
        one, other = (coal.Transform3s(turn[0], origin[0]) for turn, origin in places)
        self._function(pair)(one, other, request, result)
        normal = -np.array(result.normal)
        held = (first[0][0].T @ normal)[None]
        return Witness(
            distance=float(self._apart(pair, first, second, held)[0]),
            normal=normal,
            first_point=np.array(result.getNearestPoint1()),
            second_point=np.array(result.getNearestPoint2()),
        )

    def _function(self, pair: tuple[int, int]) -> Any:
        """Coal's function of a pair, which finds the algorithm for its kinds once."""
        if pair not in self._functions:
            self._functions[pair] = coal.ComputeDistance(*(self.bodies[index].solid for index in pair))
        return self._functions[pair]

    def _placed(self, index: int, frame: Placements) -> Placements:
        """Placements of a body whose frame is at ``frame``."""
        place = self.bodies[index].place
        return frame[0] @ place.rotation, frame[1] + frame[0] @ place.translation
