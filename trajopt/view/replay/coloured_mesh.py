"""Triangles with normals and colours, as the browser takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Points (n, 3); normals and colours, (n, 3) or one (3,); triangles (m, 3) or their corners (3m,).
MeshPart = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
WHITE = np.ones(3)


@dataclass(frozen=True, kw_only=True)
class ColouredMesh:
    """vertices, normals, colours: (n, 3), colours from 0 to 1; triangles: (m, 3) indices."""

    vertices: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    triangles: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[MeshPart]) -> ColouredMesh:
        """Return one mesh of several parts, each with triangles of its own points."""
        starts = np.cumsum([0, *(len(points) for points, *_ in parts)])
        corners = [index.ravel() + start for (*_, index), start in zip(parts, starts, strict=False)]

        def column(i: int) -> np.ndarray:
            return np.concatenate([np.broadcast_to(part[i], part[0].shape) for part in parts])

        return cls(
            vertices=column(0).astype(np.float32),
            normals=column(1).astype(np.float32),
            colours=column(2).astype(np.float32),
            triangles=np.concatenate(corners).reshape(-1, 3).astype(np.uint32),
        )


def fan(corners: int) -> np.ndarray:
    """Return the triangles (k - 2, 3) of a convex polygon of ``corners`` k."""
    return np.array([(0, i, i + 1) for i in range(1, corners - 1)])
