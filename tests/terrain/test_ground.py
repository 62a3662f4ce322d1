"""Ground as geometry: heights, normals, convex bodies, and surfaces at a distance from it."""

import json

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull, Delaunay

from tests.support.ground import HILLS, STAIRS
from tests.support.problems import FOOT, hopper
from trajopt import FlatGround, Phase
from trajopt.dynamics import Coordinates
from trajopt.robot import Units
from trajopt.terms import Context, NodePlace, SwingClearance
from trajopt.terms.friction import surface_force
from trajopt.terrain import (
    PiecewiseTerrain,
    SmoothTerrain,
    Surface,
    Wave,
    swing_path,
    terrain_from_description,
)
from trajopt.terrain.bodies import SAME_HEIGHT, ConvexGround, HalfSpace, convex_hull, ground_bodies, outline
from trajopt.terrain.crossing import crossing
from trajopt.terrain.surface import frame_of_normal
from trajopt.transcription.mesh import equal_fractions

ROUNDING = 1e-12  # numbers of order one after a few products
DIFFERENCES = 1e-7  # central differences with steps of 1e-5 of functions of order one
SEED = 5


def points(count: int, reach: float = 2.0) -> np.ndarray:
    return np.random.default_rng(SEED).uniform(-reach, reach, (count, 2))


# Piecewise ground


def test_stairs_rise_by_a_step_at_every_riser():
    x = np.array([-1.0, 0.01, 0.29, 0.31, 0.61, 5.0])
    assert_allclose(STAIRS.height(x, 0.0), [0.0, 0.1, 0.1, 0.2, 0.3, 0.3])
    assert STAIRS.names == ("before", "step1", "step2", "beyond")
    assert_allclose(PiecewiseTerrain.stairs(-0.1, 0.3, 2).height(x[[0, 1, 3]], 0.0), [0.0, -0.1, -0.2])


def test_ground_in_a_hole_is_nowhere_and_its_normal_is_up():
    gap = PiecewiseTerrain.gap(0.4, height=0.1)
    assert_allclose(gap.height([-0.1, 0.2, 0.5], 0.0), [0.0, -np.inf, 0.1])
    assert_allclose(gap.normal(0.2, 0.0), [0, 0, 1])
    assert gap.face_at(0.2, 0.0) is None
    assert STAIRS.height(0.1, 0.6) == -np.inf  # beside the stairs


def test_box_has_ground_all_around_it_and_the_highest_face_counts():
    box = PiecewiseTerrain.box(0.3, 0.6, 0.4, at=(1.0, 0.5), yaw=0.3)
    assert box.height(1.0, 0.5) == 0.3
    angle = np.linspace(0, 2 * np.pi, 50)
    assert_allclose(box.height(1.0 + np.cos(angle), 0.5 + np.sin(angle)), 0.0)


def test_slope_is_a_plane_between_two_flats():
    slope = PiecewiseTerrain.slope(0.5, 1.0)
    assert_allclose(slope.height([-1.0, 0.0, 0.5, 1.0, 2.0], 3.0), [0.0, 0.0, 0.25, 0.5, 0.5])
    assert_allclose(slope.normal(0.5, 0.0), np.array([-0.5, 0, 1]) / np.sqrt(1.25))


def test_height_is_the_highest_polygon_that_holds_the_point():
    centres = [(0.0, 0.0), (0.4, 0.1), (0.9, -0.3)]
    stones = PiecewiseTerrain.stepping_stones(centres, (0.6, 0.5), [0.0, 0.2, 0.1], yaw=0.5)
    triangulated = [Delaunay(face.vertices[:, :2]) for face in stones.faces]
    for x, y in points(400, 1.5):
        inside = [
            f.centre[2]
            for f, t in zip(stones.faces, triangulated, strict=True)
            if t.find_simplex((x, y)) >= 0
        ]
        assert stones.height(x, y) == (max(inside) if inside else -np.inf)


def test_yaw_turns_and_at_moves_an_obstacle():
    turned = PiecewiseTerrain.stairs(0.1, 0.3, 3, width=1.0, at=(0.5, -0.2), yaw=0.7)
    c, s = np.cos(0.7), np.sin(0.7)
    for x, y in points(100):
        assert turned.height(0.5 + c * x - s * y, -0.2 + s * x + c * y) == pytest.approx(STAIRS.height(x, y))


@pytest.mark.parametrize("terrain", [STAIRS, PiecewiseTerrain.slope(-0.2, 1.0, yaw=0.4), HILLS, FlatGround()])
def test_description_makes_the_terrain_again(terrain):
    again = terrain_from_description(json.loads(json.dumps(terrain.describe())))
    assert again.describe() == terrain.describe()
    assert type(again) is type(terrain)


# Smooth ground


def test_normal_is_across_the_finite_differences_of_the_height():
    step = 1e-5
    for x, y in points(50):
        slopes = [
            (HILLS.height(x + dx, y + dy) - HILLS.height(x - dx, y - dy)) / (2 * step)
            for dx, dy in ((step, 0), (0, step))
        ]
        expected = np.array([-slopes[0], -slopes[1], 1.0])
        assert_allclose(HILLS.normal(x, y), expected / np.linalg.norm(expected), atol=DIFFERENCES)


def test_symbols_of_smooth_ground_are_its_numbers():
    p, values = ca.SX.sym("p", 3), []

    def parameter(value: np.ndarray) -> ca.SX:
        values.append(value)
        return ca.SX(value)

    function = ca.Function(
        "ground", [p], [HILLS.surface.symbolic_gap(p, parameter), HILLS.surface.symbolic_frame(p, parameter)]
    )
    assert values
    for x, y in points(50):
        gap, frame = function([x, y, 0.7])
        assert_allclose(float(gap), 0.7 - HILLS.height(x, y), atol=ROUNDING)
        assert_allclose(np.array(frame), frame_of_normal(HILLS.normal(x, y)), atol=ROUNDING)


def test_tangent_plane_touches_the_ground_and_distance_is_along_its_normal():
    for x, y in points(20):
        plane = HILLS.surface.plane_at(np.array([x, y, 3.0]))
        assert plane.distance(np.array([x, y, HILLS.height(x, y)])) == pytest.approx(0.0, abs=ROUNDING)
        above = np.array([x, y, float(HILLS.height(x, y)) + 0.1])
        assert HILLS.surface.distance(above) == pytest.approx(0.1 * HILLS.normal(x, y)[2])


def test_force_on_curved_ground_is_split_along_its_normal_there():
    robot = hopper()
    contact = robot.contact(FOOT)
    context = Context(robot, Coordinates(robot.model), (contact,), surfaces={FOOT: HILLS.surface})
    force = surface_force(context, contact)
    inputs = [context.wrenches[FOOT], context.frame(FOOT).position, context.parameters]
    function = ca.Function("force", inputs, [force])
    given = np.array([1.0, -2.0, 30.0])
    for x, y in points(20):
        found = np.array(function(given, [x, y, 0.0], context.parameter_values)).ravel()
        assert found[2] == pytest.approx(given @ HILLS.normal(x, y))
        assert_allclose(found, frame_of_normal(HILLS.normal(x, y)).T @ given, atol=1e3 * ROUNDING)


def test_swing_clearance_is_the_height_over_smooth_ground():
    context = Context(hopper(), Coordinates(hopper().model), node=True)
    place = NodePlace(
        phase=Phase(name="flight", duration=0.2), index=1, fractions=equal_fractions(4), last=False
    )
    rows = SwingClearance(height=0.04, terrain=HILLS).rows(context, Units(hopper()), place)
    assert_allclose(rows.lower, 0.04 * 16 * 0.25**2 * 0.75**2)
    function = ca.Function("rows", [context.frame(FOOT).position, context.parameters], [rows.expression])
    assert float(function([0.2, 0.1, 0.9], context.parameter_values)) == pytest.approx(
        0.9 - HILLS.height(0.2, 0.1)
    )


BODY_ROUNDING = 1e-9
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
        level = np.abs(up) < BODY_ROUNDING
        if (across[level] > offsets[level] + BODY_ROUNDING).any():
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
    assert_allclose(planes, expected.equations, atol=BODY_ROUNDING)
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


RADIUS = 0.04  # the largest foot of the library, m
# Error of the height of smooth ground's parallel surface: a thousandth of a millimetre.
PARALLEL_HEIGHT = 1e-6
# Of its normal, rad: a force is that far off, a thousandth of what friction cones leave.
PARALLEL_NORMAL = 1e-3
PARALLEL_DIFFERENCES = 1e-6  # central differences with steps of 1e-5 of functions of order one
RIDGE = PiecewiseTerrain.slope(0.3, 1.0)
WAVES = SmoothTerrain(shapes=(Wave(amplitude=0.05, wavelength=0.8, yaw=0.3),))
PARALLEL_SEED = 3


def over(ground: SmoothTerrain, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the ground (n, 3) and those ``radius`` m along the normals from there."""
    x, y = np.random.default_rng(PARALLEL_SEED).uniform(-2.0, 2.0, (2, 400))
    point = np.stack([x, y, ground.height(x, y)], axis=-1)
    return point, point + radius * ground.normal(x, y)


def test_plane_patch_and_flat_ground_move_along_their_normal():
    normal = np.array([0.6, 0.0, 0.8])
    plane = Surface(point=np.array([1.0, 2.0, 3.0]), normal=normal, friction=0.4, bilateral=True)
    raised = plane.offset(RADIUS)
    assert_allclose(plane.distance(raised.point), RADIUS, atol=ROUNDING)
    assert_allclose(raised.normal, normal, atol=ROUNDING)
    assert (raised.friction, raised.bilateral) == (0.4, True)
    assert raised.offset(-RADIUS).same_plane(plane)
    ground = FlatGround(height=0.2, normal=(0.6, 0.0, 0.8), friction=0.3)
    above = ground.offset(RADIUS)
    assert_allclose(ground.surface.distance(above.surface.point), RADIUS)
    assert above.friction == 0.3
    assert FlatGround().offset(RADIUS).height == RADIUS


def test_patch_at_a_distance_has_the_same_edges_and_margin():
    patch = RIDGE.face("slope")
    raised = patch.offset(RADIUS)
    assert_allclose(patch.surface.distance(raised.vertices), RADIUS, atol=ROUNDING)
    assert_allclose(raised.inward, patch.inward, atol=ROUNDING)
    assert_allclose(raised.offsets, patch.offsets, atol=ROUNDING)
    assert raised.margin == patch.margin


@pytest.mark.parametrize(
    "ground", [FlatGround(), STAIRS, HILLS, HILLS.surface, STAIRS.surface, STAIRS.faces[0]]
)
def test_no_distance_changes_nothing(ground):
    assert ground.offset(0.0) is ground


@pytest.mark.parametrize("ground", [HILLS, WAVES])
@pytest.mark.parametrize("radius", [0.009, 0.02, RADIUS])
def test_smooth_ground_at_a_distance_goes_through_all_centres_of_balls_that_touch(ground, radius):
    point, centre = over(ground, radius)
    raised = ground.offset(radius)
    assert_allclose(raised.height(centre[:, 0], centre[:, 1]), centre[:, 2], atol=PARALLEL_HEIGHT)
    normal = ground.normal(point[:, 0], point[:, 1])
    assert_allclose(raised.normal(centre[:, 0], centre[:, 1]), normal, atol=PARALLEL_NORMAL)
    assert_allclose(raised.surface.distance(centre), 0.0, atol=PARALLEL_HEIGHT)
    assert np.array_equal(raised.offset(-radius).height(0.1, 0.2), ground.height(0.1, 0.2))


def test_symbols_of_smooth_ground_at_a_distance_are_its_numbers_with_exact_derivatives():
    p, raised = ca.SX.sym("p", 3), HILLS.offset(RADIUS).surface
    gap, frame = raised.symbolic_gap(p, ca.SX), raised.symbolic_frame(p, ca.SX)
    function = ca.Function("ground", [p], [gap, frame, ca.gradient(gap, p)])
    for place in over(HILLS, 0.3)[1][:40]:
        value, axes, slope = (np.array(out).squeeze() for out in function(place))
        assert_allclose(value, place[2] - raised.ground.height(*place[:2]), atol=ROUNDING)
        assert_allclose(axes, frame_of_normal(raised.ground.normal(*place[:2])), atol=ROUNDING)
        steps = 1e-5 * np.eye(3)
        ahead, behind = (np.array([float(function(place + s * d)[0]) for d in steps]) for s in (1, -1))
        assert_allclose(slope, (ahead - behind) / 2e-5, atol=PARALLEL_DIFFERENCES)


def test_piecewise_ground_at_a_distance_has_no_cracks_and_meets_in_concave_edges():
    raised, slope = RIDGE.offset(RADIUS), np.arctan(0.3)
    x = np.linspace(-0.5, 1.5, 801)
    height = raised.height(x, 0.0)
    assert np.isfinite(height).all()
    on_slope, on_flat = (x > 0.1) & (x < 0.9), (x < -0.1) | (x > 1.0)
    assert_allclose(height[on_slope], 0.3 * x[on_slope] + RADIUS / np.cos(slope), atol=ROUNDING)
    assert_allclose(height[on_flat], np.where(x[on_flat] < 0, 0.0, 0.3) + RADIUS, atol=ROUNDING)
    # At the convex edge the exact surface is an arc around it, which the planes exceed by less than this.
    assert height.max() - (0.3 + RADIUS) < RADIUS * (1 / np.cos(slope) - 1) + ROUNDING
    assert np.diff(height).min() > -RADIUS * (1 / np.cos(slope) - 1) - ROUNDING
    gap = PiecewiseTerrain.gap(0.4).offset(RADIUS)
    assert gap.height(0.2, 0.0) == -np.inf


def test_swing_of_a_ball_passes_an_edge_by_its_radius():
    start, end = np.array([-0.2, 0.0, RADIUS]), np.array([0.15, 0.0, 0.1 + RADIUS])
    planes = STAIRS.face("before").surface, STAIRS.face("step1").surface
    point = crossing(STAIRS, start, end, *planes)
    ball = point.offset(RADIUS, start, end)
    assert ball.top == pytest.approx(point.top + RADIUS)
    assert ball.first.height == pytest.approx(RADIUS)
    assert point.rise is not None
    assert ball.rise is not None
    assert ball.rise.distance(np.array([-RADIUS, 0.0, 0.0])) == pytest.approx(0.0, abs=ROUNDING)
    assert ball.rise.part == pytest.approx(point.rise.part - RADIUS / 0.35)


def test_guessed_swing_of_a_ball_is_clear_of_a_step():
    start, end = np.array([-0.2, 0.0, RADIUS]), np.array([0.15, 0.0, 0.1 + RADIUS])
    path = swing_path(STAIRS, 0.02, radii={"ball": RADIUS})
    places = np.array([path("ball", start, end, s) for s in np.linspace(0.0, 1.0, 401)])
    assert_allclose(places[[0, -1]], [start, end], atol=ROUNDING)
    # Distance of the centre from the riser and the tread behind it, as one solid with a corner at (0, 0.1).
    ahead, above = np.maximum(-places[:, 0], 0.0), np.maximum(places[:, 2] - 0.1, 0.0)
    assert np.hypot(ahead, above).min() >= RADIUS - ROUNDING
    assert places[:, 2].min() >= RADIUS - ROUNDING
