"""Supports and footholds against closed forms of the linear inverted pendulum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trajopt.control.footholds import (
    LONGEST,
    STAYING,
    STEADIEST,
    FootholdOffsets,
    SteadyError,
    capture_error,
)
from trajopt.control.support import Support, next_narrow, support_of, thin_axes

GRAVITY, HEIGHT, LENGTH = 9.81, 0.32, 0.5
TIME = float(np.sqrt(LENGTH / GRAVITY))
PERIOD = 1e-3
# Shares of the height and of a metre that are no extent.
LEAST = 1e-2


def support(places: list[list[float]], moved: float = 0.0) -> Support:
    """Feet at places (n, 2) on level ground, which should stand ``moved`` m less to the left."""
    own = np.column_stack([places, np.zeros(len(places))])
    centre = np.array([*own.mean(axis=0)[:2], HEIGHT])
    return support_of(own, own - [0.0, moved, 0.0], thin_axes(own, LEAST), centre, GRAVITY, LEAST * LENGTH)


def pendulum(error: np.ndarray, change: np.ndarray, rate: float, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of dd e = rate^2 e after t seconds."""
    grown, turned = np.cosh(rate * t), np.sinh(rate * t)
    return grown * error + turned / rate * change, rate * turned * error + grown * change


@pytest.mark.parametrize(
    ("places", "thin"),
    [
        ([[0.1, 0.2]], 2),
        ([[0.2, 0.1], [-0.2, -0.1]], 1),
        ([[0.2, 0.1], [-0.2, -0.1], [0.0, 1e-3]], 1),
        ([[0.2, 0.1], [-0.2, -0.1], [0.2, -0.1]], 0),
    ],
)
def test_axes_without_extent_are_across_the_feet(places: list[list[float]], thin: int) -> None:
    found = support(places)
    assert found.axes.shape == (thin, 3)
    assert_allclose(found.axes @ found.axes.T, np.eye(thin), atol=1e-12)
    assert_allclose(found.axes[:, 2], 0.0)
    if thin == 1:
        along = found.places[1] - found.places[0]
        assert abs(float(found.axes[0] @ along)) < LEAST
    assert found.rate == pytest.approx(np.sqrt(GRAVITY / HEIGHT))


def test_only_gravity_turns_a_robot_about_the_line_of_feet_of_different_heights() -> None:
    """About it dL = m g (c - p) u, and the forces of the feet have no lever."""
    random = np.random.default_rng(0)
    places = np.array([[0.2, 0.1, 0.05], [-0.2, -0.1, -0.03]])
    centre, weight = random.normal(size=3), 20.0
    found = support_of(places, places, thin_axes(places, LEAST), centre, GRAVITY, LEAST * LENGTH)
    assert found.lines.shape == (1, 3)
    assert np.hypot(*found.lines[0, :2]) == pytest.approx(1.0)
    middle, forces = places.mean(axis=0), random.normal(size=(2, 3))
    assert np.cross(places - middle, forces).sum(axis=0) @ found.lines[0] == pytest.approx(0.0, abs=1e-12)
    gravity = np.cross(centre - middle, [0.0, 0.0, -weight]) @ found.lines[0]
    assert gravity == pytest.approx(weight * float((centre - middle) @ found.axes[0]))


def test_lines_of_a_point_are_level() -> None:
    found = support([[0.1, 0.2]])
    assert_allclose(found.lines, np.cross([0.0, 0.0, 1.0], found.axes), atol=1e-12)


def test_a_narrow_stance_is_known_ahead_while_its_feet_stand_wide() -> None:
    four, left, none = [True] * 4, [True, False, True, False], [False] * 4
    active = np.array([four, four, left, none, left, four])
    wide = np.array([True, True, False, True, False, True])
    assert_allclose(next_narrow(active, wide), np.array([left, left, none, none, none, none]))


def test_the_capture_point_at_touchdown_is_that_of_the_pendulum() -> None:
    """What it is predicted to be is what an integrated pendulum has, over a line that is 2 cm off."""
    line, left = support([[0.2, 0.0], [-0.2, 0.0]], moved=0.02), 0.15
    error, change = np.array([0.01, 0.03, 0.0]), np.array([-0.1, 0.2, 0.0])
    found = capture_error(error, change, line, left, 1.0)
    own, rate = pendulum(error - line.offset, change, line.rate, left)
    assert found[1] == pytest.approx((own + rate / line.rate + line.offset)[1])
    assert found[0] == pytest.approx((error + change / line.rate)[0])  # along the line feedback holds it


def test_in_flight_the_centre_of_mass_is_thrown() -> None:
    error, change = np.array([0.01, -0.02, 0.0]), np.array([0.2, 0.1, 0.0])
    assert_allclose(capture_error(error, change, None, 0.2, 5.0), error + 0.2 * change + change / 5.0)


def test_the_error_of_a_pendulum_falls_by_its_own_equation() -> None:
    line = support([[0.2, 0.0], [-0.2, 0.0]], moved=0.02)
    assert_allclose(line.offset, [0.0, 0.02, 0.0], atol=1e-12)
    assert_allclose(line.falling(line.offset), 0.0, atol=1e-12)
    assert_allclose(line.falling(np.zeros(3)), [0.0, -0.02 * GRAVITY / HEIGHT, 0.0], atol=1e-12)


def test_a_centre_of_pressure_stays_between_the_feet_of_a_line() -> None:
    line, centre = support([[0.2, 0.0], [-0.2, 0.0]]), np.array([0.05, 0.0, HEIGHT])
    most, least = line.rate**2 * 0.25, line.rate**2 * -0.15
    for wanted, given in ((100.0, most), (-100.0, least), (0.5, 0.5)):
        found = line.reachable(centre, np.array([wanted, 0.3, 1.0]))
        assert_allclose(found, [given, 0.3, 1.0], atol=1e-12)
    wide = support([[0.2, 0.1], [-0.2, 0.1], [0.0, -0.1]])
    assert_allclose(wide.reachable(centre, np.array([100.0, 0.0, 0.0])), [100.0, 0.0, 0.0])


def swung(steps: int, error: float, capture: float) -> tuple[FootholdOffsets, np.ndarray]:
    """A foot that swings for ``steps`` ticks; its offsets (steps, 2)."""
    feet, path = FootholdOffsets(1, period=PERIOD, length=LENGTH, time=TIME), []
    for k in range(steps):
        feet.swing(0, np.array([error, 0.0, 0.0]), np.array([capture, 0.0, 0.0]), (steps - k) * PERIOD)
        path.append(feet.offset[0].copy())
    return feet, np.array(path)


def test_a_foot_lands_beside_its_foothold_by_the_capture_error_at_rest() -> None:
    feet, path = swung(400, 0.02, 0.05)
    assert feet.offset[0, 0] == pytest.approx(0.05, abs=1e-3)
    assert abs(feet.rate[0, 0]) < 0.02
    # The cubic of least acceleration, but for the last part, which takes as long as it needs.
    whole = np.arange(1, 401) / 400
    assert_allclose(path[:300, 0], (0.05 * (3 * whole**2 - 2 * whole**3))[:300], atol=1e-3)
    assert not path[:, 1].any()


def test_steps_are_no_longer_than_legs_allow() -> None:
    feet, _ = swung(400, 0.1, 5.0)
    assert feet.offset[0, 0] == pytest.approx(0.1 + LONGEST * LENGTH, abs=5e-3)


def test_offsets_of_a_copy_are_its_own() -> None:
    feet, _ = swung(10, 0.0, 0.1)
    own = feet.copy()
    own.stand(0, np.array([1.0, 2.0]))
    assert_allclose(own.offset[0], [1.0, 2.0])
    assert not own.rate.any()
    assert feet.offset[0, 0] < 0.1


def steady(rate: float) -> SteadyError:
    return SteadyError(rate=rate, period=PERIOD, length=LENGTH, time=TIME)


def test_an_error_that_stays_is_integrated_up_to_a_part_of_the_reach() -> None:
    error, slow = np.array([0.02, -0.01, 0.0]), np.zeros(3)
    found = steady(0.5)
    for _ in range(1000):
        found.update(error, slow)
    assert_allclose(found.integral, 0.5 * error, rtol=1e-9)
    for _ in range(100_000):
        found.update(error, slow)
    assert_allclose(found.integral[:2], [STEADIEST * LENGTH, -STEADIEST * LENGTH])
    for _ in range(100):
        found.update(-error, slow)  # and goes back at once
    assert_allclose(found.integral[:2], [STEADIEST * LENGTH - 1e-3, -STEADIEST * LENGTH + 5e-4], rtol=1e-9)


def test_the_error_after_a_push_is_not_one_that_stays() -> None:
    found, fast = steady(0.5), np.array([0.0, 1.01 * STAYING * LENGTH / TIME, 0.0])
    found.update(np.array([0.1, 0.1, 0.0]), fast)
    assert_allclose(found.integral, 0.0)
    apart = found.copy()
    apart.update(np.array([0.1, 0.1, 0.0]), fast / 1.02)
    assert apart.integral[0] > 0.0
    assert_allclose(found.integral, 0.0)
