"""Ground at a distance: the surfaces on which centres of contacts with a radius lie."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.ground import HILLS, STAIRS
from trajopt.terrain.crossing import crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.shapes import Wave
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface, frame_of_normal
from trajopt.terrain.swing_paths import swing_path

ROUNDING = 1e-12  # numbers of order one after a few products
RADIUS = 0.04  # the largest foot of the library, m
# Error of the height of smooth ground's parallel surface: a thousandth of a millimetre.
PARALLEL_HEIGHT = 1e-6
# Of its normal, rad: a force is that far off, a thousandth of what friction cones leave.
PARALLEL_NORMAL = 1e-3
DIFFERENCES = 1e-6  # central differences with steps of 1e-5 of functions of order one
RIDGE = PiecewiseTerrain.slope(0.3, 1.0)
WAVES = SmoothTerrain(shapes=(Wave(amplitude=0.05, wavelength=0.8, yaw=0.3),))
SEED = 3


def over(ground: SmoothTerrain, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the ground (n, 3) and those ``radius`` m along the normals from there."""
    x, y = np.random.default_rng(SEED).uniform(-2.0, 2.0, (2, 400))
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
        assert_allclose(slope, (ahead - behind) / 2e-5, atol=DIFFERENCES)


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
