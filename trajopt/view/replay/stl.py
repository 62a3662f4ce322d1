"""Triangles of a binary STL file."""

from __future__ import annotations

import numpy as np

# A header that ends with the number of triangles, and 50 bytes for each.
HEADER = 84
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_corners(data: bytes) -> np.ndarray | None:
    """Corners (3m, 3) of the m triangles that a file is long enough for; None of one written in words."""
    count = (len(data) - HEADER) // TRIANGLE.itemsize
    if count < 0 or len(data) != HEADER + count * TRIANGLE.itemsize:
        return None
    return np.asarray(np.frombuffer(data, TRIANGLE, count, HEADER)["corners"].reshape(-1, 3))


def stated_triangles(data: bytes) -> int:
    """The number of triangles in the header of a file that has one."""
    return int(np.frombuffer(data, "<u4", 1, HEADER - 4)[0])
