"""The ground as convex bodies: their union is the terrain, and only risers have sides."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull

from trajopt.terrain import FlatGround, PiecewiseTerrain
from trajopt.terrain.bodies import SAME_HEIGHT, ConvexGround, HalfSpace, convex_hull, ground_bodies, outline

ROUNDING = 1e-9
P = PiecewiseTerrain
TERRAINS = {
    "stairs": (P.stairs(0.1, 0.3, 4, at=(0.5, 0.2), yaw=0.4), 5),
    "stairs down": (P.stairs(-0.1, 0.3, 4), 5),
    "box": (P.box(0.3, 0.5, 0.6, yaw=0.3), 2),
    "pit": (P.box(-0.3, 0.5, 0.6), 5),
    "gap": (P.gap(0.3), 2),
    "slope": (P.slope(0.3, 1.0), 2),
    "slope down": (P.slope(-0.3, 1.0), 2),
    "stones": (P.stepping_stones([(0, 0), (0.4, 0), (0.8, 0.1)], 0.25, [0, 0.05, 0.1]), 3),
}


def height(bodies: tuple[ConvexGround, ...], x: float, y: float) -> float:
    """Height of the highest body over (x, y); -inf where there is none."""
    found = [-np.inf]
    for body in bodies:
        normals, offsets = body.planes
        across, up = normals[:, :2] @ [x, y], normals[:, 2]
        level = np.abs(up) < ROUNDING
        if (across[level] > offsets[level] + ROUNDING).any():
            continue
        tops = (offsets - across)[~level] / up[~level]
        high, low = tops[up[~level] > 0].min(), tops[up[~level] < 0].max()
        found += [high] if high >= low else []
    return max(found)


@pytest.mark.parametrize("name", TERRAINS)
def test_union_of_the_bodies_is_the_ground_below_the_faces(name):
    terrain, count = TERRAINS[name]
    bodies = ground_bodies(terrain)
    assert len(bodies) == count
    for x, y in np.random.default_rng(0).uniform(-3, 3, (300, 2)):
        assert height(bodies, x, y) == pytest.approx(float(terrain.height(x, y)), abs=2 * SAME_HEIGHT)


@pytest.mark.parametrize("name", ["box", "slope", "slope down"])
def test_level_ground_has_no_side_under_what_stands_on_it(name):
    """Every body that reaches the level ground's height spans all of it."""
    terrain, _ = TERRAINS[name]
    widest = max(np.ptp(body.points[:, 0]) for body in ground_bodies(terrain))
    assert widest >= 40.0


def test_plane_is_a_half_space():
    (body,) = ground_bodies(FlatGround(height=0.2, normal=(0.1, 0.0, 1.0)))
    assert isinstance(body, HalfSpace)
    assert body.normal @ [0, 0, 0.2] == pytest.approx(body.offset)


@pytest.mark.parametrize("seed", range(20))
def test_hulls_are_scipys(seed):
    """Of points of which many are equal or on one line, too."""
    points = np.round(np.random.default_rng(seed).normal(size=(5 + seed, 3)), 1 + seed % 3)
    points = np.concatenate([points, points[:3]])
    hull, expected = convex_hull(points), ConvexHull(points)
    assert_array_equal(np.unique(hull.corners, axis=0), np.unique(points[expected.vertices], axis=0))
    planes = np.column_stack([hull.normals, -hull.offsets])
    assert_allclose(planes, expected.equations, atol=ROUNDING)
    assert_allclose(
        np.sum(hull.corners[hull.triangles[:, 0]] * hull.normals, axis=1), hull.offsets, atol=SAME_HEIGHT
    )
    around, level = points[outline(points[:, :2])][:, :2], ConvexHull(points[:, :2])
    first = np.flatnonzero((level.points[level.vertices] == around[0]).all(axis=1))[0]
    assert_array_equal(around, np.roll(level.points[level.vertices], -first, axis=0))


@pytest.mark.parametrize(
    "points", [np.zeros((0, 2)), np.zeros((3, 2)), np.outer([0.0, 1, 2, 0.3], [0.1, 0.7])]
)
def test_outline_of_points_without_area_has_less_than_three_corners(points):
    assert len(outline(points)) < 3
