"""Points all over the surface of a convex hull."""

from __future__ import annotations

import numpy as np

from trajopt.collision.coal_shapes import thick

# Distance between neighbours, m: over ground with a radius of curvature R the hull between them comes nearer
# by at most SPACING^2 / (6 R), 0.7 mm at R = 0.1 m.
SPACING = 0.02


def surface_points(points: np.ndarray) -> np.ndarray:
    """The ``points`` (n, 3) m of a hull and others on its edges and faces, at most `SPACING` apart."""
    if len(points) == 1:
        return points
    if len(points) == 2:
        steps = int(np.ceil(np.linalg.norm(points[1] - points[0]) / SPACING))
        share = np.linspace(0.0, 1.0, max(steps, 1) + 1)[:, None]
        return np.asarray(points[0] + share * (points[1] - points[0]))
    from scipy.spatial import ConvexHull  # takes a while to load

    solid = thick(points)
    found = [_on_triangle(solid[corners]) for corners in ConvexHull(solid).simplices]
    return np.unique(np.round(np.concatenate(found), 9), axis=0)


def _on_triangle(corners: np.ndarray) -> np.ndarray:
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())
    steps = max(int(np.ceil(longest / SPACING)), 1)
    weights = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return np.asarray(np.array(weights) / steps @ corners)
