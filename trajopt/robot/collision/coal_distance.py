"""Signed distances and nearest points of pairs of moving shapes, by Coal."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.dynamics.joint_placements import Placements


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """Where two bodies are nearest, or the shortest way out of each other.

    normal: (3,) world, unit, from the second body to the first. distance: signed, m: the least height of the
    first body along the normal minus the greatest of the second. first_point, second_point: (3,) m, world, on
    the surfaces: first_point = second_point + distance normal.
    """

    distance: float
    normal: np.ndarray
    first_point: np.ndarray
    second_point: np.ndarray


@dataclass(frozen=True)
class CoalPairs:
    """Coal's bodies, each with its placement in its frame; a pair is given by two indices."""

    bodies: list[tuple[Any, pin.SE3]]
    _functions: dict[tuple[int, int], Any] = field(default_factory=dict, init=False)

    def distances(self, pair: tuple[int, int], first: Placements, second: Placements) -> np.ndarray:
        """Signed distances (k,) m of a pair whose frames are at these placements (k, 3, 3), (k, 3)."""
        measure, request, result = self._function(pair), coal.DistanceRequest(), coal.DistanceResult()
        one, other = coal.Transform3s(), coal.Transform3s()
        places = [self._placed(index, frame) for index, frame in zip(pair, (first, second), strict=True)]
        found = np.empty(len(first[0]))
        for k, (a, b, c, d) in enumerate(zip(*places[0], *places[1], strict=True)):
            one.setTransform(a, b)
            other.setTransform(c, d)
            result.clear()
            found[k] = measure(one, other, request, result)
        return found

    def witness(self, pair: tuple[int, int], first: Placements, second: Placements) -> Witness:
        """Nearest points of a pair whose frames are at one placement (1, 3, 3), (1, 3) each."""
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        places = [self._placed(index, frame) for index, frame in zip(pair, (first, second), strict=True)]
        one, other = (coal.Transform3s(turn[0], origin[0]) for turn, origin in places)
        distance = float(self._function(pair)(one, other, request, result))
        return Witness(
            distance=distance,
            normal=-np.array(result.normal),
            first_point=np.array(result.getNearestPoint1()),
            second_point=np.array(result.getNearestPoint2()),
        )

    def _function(self, pair: tuple[int, int]) -> Any:
        """Coal's function of a pair, which finds the algorithm for its kinds once."""
        if pair not in self._functions:
            self._functions[pair] = coal.ComputeDistance(self.bodies[pair[0]][0], self.bodies[pair[1]][0])
        return self._functions[pair]

    def _placed(self, index: int, frame: Placements) -> Placements:
        """Placements of a body whose frame is at ``frame``."""
        place = self.bodies[index][1]
        return frame[0] @ place.rotation, frame[1] + frame[0] @ place.translation
