"""The ground as feet feel it."""

import numpy as np
from numpy.testing import assert_allclose

from trajopt.control.mpc.ground import MARGIN, STEEPEST, GroundEstimate, KnownGround
from trajopt.terrain import PiecewiseTerrain

LENGTH, RISE = 0.3, 0.1
STEP = PiecewiseTerrain.stairs(RISE, 1.0, 1, at=(0.5, 0.0))
FEET = np.array([[0.2, 0.15, 0.0], [0.2, -0.15, 0.0], [-0.2, 0.15, 0.0], [-0.2, -0.15, 0.0]])


def touched(slope: float, times: int = 200) -> GroundEstimate:
    ground = GroundEstimate(4, 0.3)
    places = FEET.copy()
    places[:, 2] = slope * places[:, 0] + 0.1
    for _ in range(times):
        ground.touch(places, np.ones(4, dtype=bool))
    return ground


def test_a_plane_is_found_but_for_the_pull_to_level() -> None:
    ground = touched(0.2)
    assert 0.15 < ground.slope[0] < 0.2
    assert abs(ground.slope[1]) < 1e-9
    assert_allclose(ground.height(0.0, 0.0), 0.1, atol=1e-9)


def test_feet_in_the_air_tell_nothing_and_walls_are_not_believed() -> None:
    ground = GroundEstimate(4, 0.3)
    ground.touch(FEET + 1.0, np.zeros(4, dtype=bool))
    assert_allclose(ground.height(3.0, 2.0), 0.0)
    assert np.linalg.norm(touched(5.0).slope) <= STEEPEST + 1e-12


def test_a_copy_goes_on_apart() -> None:
    ground = touched(0.0)
    twin = ground.copy()
    twin.touch(FEET + np.array([0.0, 0.0, 1.0]), np.ones(4, dtype=bool))
    assert_allclose(ground.height(0.0, 0.0), 0.1)


def known(terrain: PiecewiseTerrain) -> KnownGround:
    return KnownGround(4, LENGTH, 0.25, terrain)


def test_footholds_keep_clear_of_edges_and_leave_room_for_the_leg_below_a_step() -> None:
    """Before a step they are as far from it as it is high, beyond the margin that both sides have."""
    ground, margin = known(STEP), MARGIN * LENGTH
    assert_allclose(ground.foothold(np.array([0.2, 0.1])), [0.2, 0.1, 0.0])
    for x in np.linspace(0.3, 0.7, 41):
        place, height, _ = ground.foothold(np.array([x, 0.0]))[[0, 2, 1]]
        assert abs(place - x) < 0.6 * LENGTH
        assert height == (RISE if place > 0.5 else 0.0)
        assert place >= 0.5 + 0.9 * margin or place <= 0.5 - 0.7 * (margin + RISE)


def test_footholds_beside_holes_are_on_faces() -> None:
    ground = known(PiecewiseTerrain.gap(0.12, at=(0.5, 0.0)))
    for x in np.linspace(0.45, 0.65, 21):
        place, _, height = ground.foothold(np.array([x, 0.0]))
        assert height == 0.0
        assert not 0.5 - 0.9 * MARGIN * LENGTH < place < 0.62 + 0.9 * MARGIN * LENGTH


def test_a_swing_is_above_the_ground_on_its_way() -> None:
    """Up, down, and over a box between start and goal; on level ground it is level."""
    box = PiecewiseTerrain.box(RISE, 0.05, 1.0, at=(0.5, 0.0))
    s = np.linspace(0.0, 1.0, 201)
    for terrain, start, goal in ((STEP, 0.35, 0.55), (STEP, 0.55, 0.35), (box, 0.4, 0.6)):
        ends = [np.array([x, 0.0, float(terrain.height(x, 0.0))]) for x in (start, goal)]
        path, pull = known(terrain).swing(s, *ends)
        assert_allclose(path[[0, -1]], ends, atol=1e-12)
        assert (pull == 1.0).all()
        lift = path[:, 2] + 0.25 * LENGTH * 16 * s**2 * (1 - s) ** 2
        assert (lift >= terrain.height(path[:, 0], 0.0) - 1e-12).all()


def test_the_height_for_the_base_is_a_mean_and_its_slope_that_of_the_mean() -> None:
    ground, x = known(STEP), np.linspace(0.0, 1.0, 101)
    heights = ground.height(x, 0.0 * x)
    assert_allclose(heights[[0, -1]], [0.0, RISE], atol=1e-12)
    assert (np.diff(heights) >= -1e-12).all()
    assert_allclose(ground.height(0.5, 0.0), RISE / 2, atol=0.2 * RISE)
    tilted = known(PiecewiseTerrain.slope(2.0, 20.0))
    tilted.touch(FEET + np.array([5.0, 0.0, 0.0]), np.ones(4, dtype=bool))
    assert_allclose(tilted.slope, [0.1, 0.0], atol=1e-9)
    assert_allclose(tilted.height(5.0, 0.0), 0.5, atol=1e-9)
