"""Beams: mass and inertia from geometry against Pinocchio, quadrature, and sums of plates."""

import numpy as np
import pinocchio as pin
import pytest

from trajopt.errors import InputError
from trajopt.robot.actuators.beams import DENSITY, Beam, assembled

# Sums of a few products of doubles.
ROUNDING = 1e-13
# Midpoint rule with 60 cells an edge on a quadratic: relative error 1 / 60^2 of each moment at most.
QUADRATURE = 3e-4
CELLS = 60
HOLLOW = Beam(length=0.7, width=0.16, height=0.2, wall=0.006)


def quadrature(beam: Beam) -> tuple[float, np.ndarray]:
    """Mass and inertia tensor by the lecture's integrals of the density, cell by cell."""
    sizes = np.array([beam.length, beam.width, beam.height])
    edges = [np.linspace(-size / 2, size / 2, CELLS + 1) for size in sizes]
    axes = [(edge[1:] + edge[:-1]) / 2 for edge in edges]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    inner = np.array(beam.hole) / 2
    full = (np.abs(y) > inner[0]) | (np.abs(z) > inner[1])
    cell = beam.kilograms_per_cubic_metre * np.prod(sizes) / CELLS**3 * full
    r = np.stack([x, y, z])
    second = np.einsum("iabc,jabc,abc->ij", r, r, cell)
    return float(cell.sum()), np.trace(second) * np.eye(3) - second


def test_solid_beam_is_the_uniform_box_of_pinocchio():
    beam = Beam(length=0.3, width=0.1, height=0.2, density=2500.0)
    mass = 2500.0 * 0.3 * 0.1 * 0.2
    box = pin.Inertia.FromBox(mass, 0.3, 0.1, 0.2)
    assert beam.mass == pytest.approx(mass, rel=ROUNDING)
    np.testing.assert_allclose(beam.spatial_inertia().matrix(), box.matrix(), rtol=0, atol=ROUNDING * mass)


def test_hollow_beam_agrees_with_quadrature_of_the_density():
    """Walls of ten and five cells lie on cell edges, so only the rule's own error is left."""
    beam = Beam(length=0.6, width=0.12, height=0.24, wall=0.02, density="aluminium")
    mass, inertia = quadrature(beam)
    assert beam.mass == pytest.approx(mass, rel=ROUNDING)
    np.testing.assert_allclose(beam.inertia, inertia, rtol=QUADRATURE, atol=QUADRATURE * mass * 1e-3)


def test_hollow_beam_is_the_sum_of_its_four_plates():
    t = HOLLOW.wall
    sides = Beam(length=0.7, width=t, height=0.2)
    lids = Beam(length=0.7, width=0.16 - 2 * t, height=t)
    plates = [(sides, (0, s * (0.16 - t) / 2, 0)) for s in (-1, 1)]
    plates += [(lids, (0, 0, s * (0.2 - t) / 2)) for s in (-1, 1)]
    total = assembled([plate.spatial_inertia(pin.SE3(np.eye(3), np.array(at))) for plate, at in plates])
    np.testing.assert_allclose(total.matrix(), HOLLOW.spatial_inertia().matrix(), rtol=0, atol=1e-12)


def test_wall_of_half_the_smaller_size_is_solid():
    solid, full = (Beam(length=1.0, width=0.1, height=0.2, wall=wall) for wall in (None, 0.05))
    assert full.mass == pytest.approx(solid.mass, rel=ROUNDING)
    np.testing.assert_allclose(full.inertia, solid.inertia, rtol=ROUNDING)


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.7), (0.0, 0.0, -0.7), (0.7, 0.0, 0.0), (0.3, -0.4, 0.5)])
def test_beam_between_points_has_its_centre_halfway_and_its_axis_along_the_line(end):
    start = np.array([0.1, 0.2, 0.3])
    placed = HOLLOW.between(start, start + np.array(end))
    along = np.array(end) / np.linalg.norm(end)
    np.testing.assert_allclose(placed.lever, start + np.array(end) / 2, atol=ROUNDING)
    assert along @ placed.inertia @ along == pytest.approx(HOLLOW.inertia[0, 0], rel=1e-12)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(placed.inertia), np.sort(np.diag(HOLLOW.inertia)), rtol=1e-12
    )


def test_mass_is_that_of_the_material():
    for material, density in DENSITY.items():
        section = 0.16 * 0.2 - (0.16 - 0.012) * (0.2 - 0.012)
        beam = Beam(length=0.7, width=0.16, height=0.2, wall=0.006, density=material)
        assert beam.mass == pytest.approx(density * 0.7 * section, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": 0.0}, "length of Beam is 0"),
        ({"width": -1.0}, "width of Beam"),
        ({"height": float("nan")}, "height of Beam"),
        ({"wall": 0.09}, "at most 0.08 m"),
        ({"wall": 0.0}, "wall of Beam"),
        ({"density": "wood"}, "steel, aluminium, iron"),
        ({"density": -5.0}, "density of Beam"),
    ],
)
def test_beams_that_cannot_be_are_refused(change, message):
    sizes = {"length": 0.7, "width": 0.16, "height": 0.2, "wall": 0.006}
    with pytest.raises(InputError, match=message):
        Beam(**{**sizes, **change})


def test_beam_between_equal_points_is_refused():
    with pytest.raises(InputError, match="two different points"):
        HOLLOW.between(np.ones(3), np.ones(3))
