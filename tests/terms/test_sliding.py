"""Smooth friction cones, and sliding contacts that Coulomb's friction brings to rest."""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import FOOT, hopper
from trajopt import Contact, FlatGround, Phase, Problem, Robot, Schedule
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.certify.report import AT_POINTS
from trajopt.certify.sliding import SlidingDynamics
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.terms import AccelerationCost, Context, FrictionCone
from trajopt.terms.dynamics import require_sliding
from trajopt.terms.friction import APEX, TIGHT
from trajopt.terrain.surface import Surface
from trajopt_library import robots

MASS, FRICTION, SPEED, GRAVITY = 2.0, 0.3, 1.5, 9.81
# Far below the block's speed: friction is mu m g then, but for half the square of the ratio.
SLIP = 1e-3
DURATION = 0.3  # s, before it stops at v / (mu g) = 0.51
ROUNDING = 1e-10


def block() -> Robot:
    """A point mass on three slides along the world's axes, none of them driven."""
    model, parent = pin.Model(), 0
    for axis, joint in zip("xyz", (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ), strict=True):
        parent = model.addJoint(parent, joint(), pin.SE3.Identity(), axis)
        model.addJointFrame(parent)
    model.appendBodyToJoint(parent, pin.Inertia.FromSphere(MASS, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("block", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot.from_model(model, name="block", contacts=["block"], passive=("x", "y", "z"))


def slope(angle: float, **options: float) -> Surface:
    normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    return Surface(point=np.zeros(3), normal=normal, friction=FRICTION, slip_speed=SLIP, **options)


def sliding_block(surface: Surface, velocity: np.ndarray) -> Problem:
    return Problem(
        name="block",
        robot=block(),
        schedule=Schedule(
            (Phase(name="slide", duration=DURATION, contacts=("block",), surfaces={"block": surface}),)
        ),
        terrain=FlatGround(),
        initial_q=np.zeros(3),
        initial_v=velocity,
        terms=(AccelerationCost(weight=1.0),),
        guess=lambda t: t * velocity,
        default_intervals=10,
    )


@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_a_block_is_braked_by_friction_on_a_plane(angle):
    surface = slope(angle)
    up = np.array([np.cos(angle), 0.0, np.sin(angle)])
    solution = trajopt.solve(sliding_block(surface, SPEED * up), fixed_mesh=True)
    assert solution.converged
    assert trajopt.check(solution).within(AT_POINTS)
    braking = GRAVITY * (np.sin(angle) + FRICTION * np.cos(angle))
    expected = SPEED * DURATION - braking * DURATION**2 / 2
    # Friction below mu f_n by half (v_s / v)^2, and the collocation of its change.
    np.testing.assert_allclose(solution.q[-1], expected * up, atol=1e-5)
    assert solution.f[solution.collocation][0, 0, :3] @ surface.normal == pytest.approx(
        MASS * GRAVITY * np.cos(angle), rel=1e-6
    )


def test_dynamics_of_a_contact_without_friction_are_those_of_a_multiplier_along_the_normal():
    robot = block()
    contacts = ContactSet.of(robot.model, [("block", 3)])
    surface = replace(slope(0.4), friction=0.0)
    q, v, force = np.zeros(3), np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 3.0])
    found = SlidingDynamics(robot.model, contacts, {0: surface}).acceleration(q, v, force)
    free = force / MASS - np.array([0.0, 0.0, GRAVITY])
    expected = free - (surface.normal @ free) * surface.normal
    np.testing.assert_allclose(found, expected, atol=ROUNDING)


def test_dynamics_without_sliding_contacts_are_those_of_held_ones():
    robot = block()
    contacts = ContactSet.of(robot.model, [("block", 3)])
    state = np.zeros(3), np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 3.0])
    found = SlidingDynamics(robot.model, contacts, {}).acceleration(*state)
    np.testing.assert_allclose(
        found, ContactDynamics(robot.model, contacts).acceleration(*state), atol=ROUNDING
    )


def test_compiled_dynamics_slide_and_hold_as_those_of_python():
    robot, generator = robots.load("go2"), np.random.default_rng(5)
    model = robot.model
    surfaces = {0: slope(0.3), 2: slope(-0.2)}
    dynamics = SlidingDynamics(model, ContactSet.of(model, robot.contacts), surfaces)
    q = np.array([pin.integrate(model, robot.reference, 0.2 * generator.normal(size=18)) for _ in range(20)])
    v, force = generator.normal(size=(2, 20, 18))
    expected = np.array([dynamics.acceleration(*row) for row in zip(q, v, force, strict=True)])
    found = dynamics.compiled.accelerations(q, v, force)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    with pytest.raises(ValueError, match="no point of that number holds its place"):
        dynamics.compiled.slide(0, surfaces[0].normal, 0.5, 0.1)


def test_a_sliding_surface_survives_its_description():
    surface = slope(0.3)
    described = Surface.from_description(surface.describe())
    assert described.slip_speed == surface.slip_speed
    held = replace(surface, slip_speed=None).describe()
    assert "slip_speed" not in held  # files of surfaces that hold are as they were
    assert Surface.from_description(held).slip_speed is None


@pytest.mark.parametrize("slip", [0.0, -1.0, np.nan, "fast", True])
def test_a_slip_speed_that_is_none_is_refused(slip):
    with pytest.raises(InputError, match="slip_speed"):
        Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), slip_speed=slip)


def test_what_cannot_slide_is_refused():
    surface = slope(0.0)
    with pytest.raises(InputError, match="bilateral"):
        Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), slip_speed=SLIP, bilateral=True)
    problem = sliding_block(surface, np.zeros(3))
    sole = Contact(frame="block", kind="surface", half_length=0.1, half_width=0.1)
    with pytest.raises(InputError, match="point contacts"):
        replace(problem, robot=replace(problem.robot, contacts=(sole,)))
    with pytest.raises(InputError, match="actuation"):
        require_sliding(problem.robot, problem.schedule, "acceleration", ())
    slide = problem.schedule.phases[0]
    hold = replace(slide, name="hold", surfaces={"block": replace(surface, slip_speed=None)})
    with pytest.raises(InputError, match="hold"):
        replace(problem, schedule=Schedule((slide, hold)))


MU = 0.6
LEVEL = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=MU)
# Normal forces over the weight, from none to twice the weight.
NORMAL = np.concatenate([[0.0], np.geomspace(1e-7, 2.0, 60)])
CONE_ROUNDING = 1e-12


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
        assert largest is None or largest <= MU * normal * (1 + CONE_ROUNDING)


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
        assert_allclose(tangential_at(normal, 0.0), MU * normal, rtol=CONE_ROUNDING)


@pytest.mark.parametrize("f", [[0, 0, 0], [1e-9, 0, 0], [0, 0, 1e-3], [2e-3, -1e-3, 4e-3], [0.1, 0.2, 1.0]])
def test_derivatives_are_finite_and_those_of_the_row(f):
    f, step = np.array(f, dtype=float), 1e-5
    _, gradient, hessian = (np.array(part) for part in row()(f))
    ahead, behind = ([row()(f + s * axis) for axis in step * np.eye(3)] for s in (1, -1))
    slope = [float(a[0] - b[0]) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    bend = [np.array(a[1] - b[1]).ravel() / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    assert_allclose(gradient.ravel(), slope, atol=1e-6)
    assert_allclose(hessian, np.array(bend).T, atol=1e-2)  # of at most 2 / APEX
