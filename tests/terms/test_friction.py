"""The row of the smooth friction cone near zero force: its set, its violation, its derivatives."""

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import FOOT, hopper
from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.units import Units
from trajopt.terms import Context, FrictionCone
from trajopt.terms.friction import APEX, TIGHT
from trajopt.terrain.surface import Surface

MU = 0.6
LEVEL = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=MU)
# Normal forces over the weight, from none to twice the weight.
NORMAL = np.concatenate([[0.0], np.geomspace(1e-7, 2.0, 60)])
ROUNDING = 1e-12


@lru_cache
def row() -> ca.Function:
    """The row, and its gradient and Hessian, as functions of the force (3,) over the weight."""
    robot = hopper()
    context = Context(robot, Coordinates(robot.model), (robot.contact(FOOT),), surfaces={FOOT: LEVEL})
    rows = FrictionCone().rows(context, Units(robot))
    f = ca.SX.sym("f", 3)
    inputs = [context.wrenches[FOOT], context.frame(FOOT).rotation, context.parameters]
    given = [f * Units(robot).force, ca.DM.eye(3), context.parameter_values]
    value = ca.Function("rows", inputs, [rows.expression])(*given)[1]
    hessian, gradient = ca.hessian(value, f)
    return ca.Function("row", [f], [value, gradient, hessian])


def value(f: np.ndarray) -> float:
    return float(row()(f)[0])


def tangential_at(normal: float, level: float) -> float | None:
    """The tangential force at which the row has the value ``level``, None where it is below it already."""
    if value([0.0, 0.0, normal]) < level:
        return None
    inside, outside = 0.0, 10.0
    for _ in range(100):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if value([middle, 0.0, normal]) >= level else (inside, middle)
    return inside


def test_forces_that_fulfil_the_row_are_within_coulombs_law():
    for normal in NORMAL:
        largest = tangential_at(normal, 0.0)
        assert largest is None or largest <= MU * normal * (1 + ROUNDING)


@pytest.mark.parametrize("violation", [1e-9, 1e-7, TIGHT])
def test_a_violation_of_the_row_bounds_the_distance_from_coulombs_law(violation):
    """The squared row of the whole cone would allow the root of the violation at zero normal force."""
    for normal in NORMAL:
        largest = tangential_at(normal, -violation)
        assert largest is None or largest - MU * normal <= 2 * violation


def test_only_the_tip_of_the_cone_is_left_out():
    tip = np.sqrt(TIGHT * APEX) / MU
    assert value([0.0, 0.0, 0.99 * tip]) < 0 < value([0.0, 0.0, 1.01 * tip])
    for normal in NORMAL[NORMAL > 0.02]:
        assert_allclose(tangential_at(normal, 0.0), MU * normal, rtol=ROUNDING)


@pytest.mark.parametrize("f", [[0, 0, 0], [1e-9, 0, 0], [0, 0, 1e-3], [2e-3, -1e-3, 4e-3], [0.1, 0.2, 1.0]])
def test_derivatives_are_finite_and_those_of_the_row(f):
    f, step = np.array(f, dtype=float), 1e-5
    _, gradient, hessian = (np.array(part) for part in row()(f))
    ahead, behind = ([row()(f + s * axis) for axis in step * np.eye(3)] for s in (1, -1))
    slope = [float(a[0] - b[0]) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    bend = [np.array(a[1] - b[1]).ravel() / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    assert_allclose(gradient.ravel(), slope, atol=1e-6)
    assert_allclose(hessian, np.array(bend).T, atol=1e-2)  # of at most 2 / APEX
