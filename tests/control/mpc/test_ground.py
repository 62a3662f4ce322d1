"""The ground as feet feel it."""

import numpy as np
from numpy.testing import assert_allclose

from trajopt.control.mpc.ground import STEEPEST, GroundEstimate

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
