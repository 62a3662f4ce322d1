"""Derivatives of point functions by the chain rule, and their values against numeric Pinocchio."""

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import FOOT, hopper, one_joint_arm, planar_hopper, point_of, random_point
from trajopt import _engine
from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms import (
    AccelerationCost,
    ContactAcceleration,
    Context,
    FrictionCone,
    PositionLimits,
    PostureCost,
    SoleLimits,
    TorqueCost,
    TorqueLimits,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)
from trajopt.transcription.stage_functions import Derivatives, PointFunction
from trajopt_library import robots

# Two graphs of one function in double precision, entries up to a few hundred.
SAME = {"rtol": 1e-9, "atol": 1e-9}
SEEDS = (0, 1)
COSTS = (TorqueCost, AccelerationCost, VelocityCost, PostureCost, WrenchCost)
LIMITS = (TorqueLimits(), PositionLimits(), VelocityLimits(), FrictionCone(friction=0.7))
TERMS = (*(cost(weight=0.3 + i) for i, cost in enumerate(COSTS)), *LIMITS)
FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
# Of the second derivatives of Solo12 on four feet; 43k at the time of writing.
STANCE_STATEMENTS = 50_000


class PlainContext(Context):
    """A point whose robot is evaluated in world axes, whatever its base."""

    has_free_flyer = False


def turned_hopper() -> Robot:
    """The hopper with its root joint's axes turned against the world's."""
    model = hopper().model.copy()
    model.jointPlacements[1] = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.3, 0.2), np.array([0.1, 0.0, 0.2]))
    return Robot.from_model(model, contacts=hopper().contacts, name="turned")


@lru_cache
def case(name: str) -> tuple[Robot, tuple[str, ...]]:
    return {
        "solo12-stance": lambda: (robots.load("solo12"), FEET),
        "solo12-flight": lambda: (robots.load("solo12"), ()),
        "ur5": lambda: (robots.load("ur5"), ()),
        "planar-stance": lambda: (planar_hopper(), (FOOT,)),
        "sole": lambda: (hopper("surface"), (FOOT,)),
        "hopper": lambda: (hopper(), (FOOT,)),
        "turned": lambda: (turned_hopper(), (FOOT,)),
        "arm": lambda: (one_joint_arm(gravity=True), ()),
    }[name]()


CASES = ("solo12-stance", "solo12-flight", "ur5", "planar-stance", "sole", "hopper", "arm")
FREE_FLYING = ("solo12-stance", "solo12-flight", "sole", "hopper")


@lru_cache
def built(name: str) -> tuple[PointFunction, np.ndarray, Derivatives]:
    robot, contacts = case(name)
    terms = (*TERMS, SoleLimits(friction=0.7)) if name == "sole" else TERMS
    point, parameters = point_of(robot, contacts, terms)
    return point, parameters, Derivatives(point)


def composed(point: PointFunction, z: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Cost and rows with all layers put into one graph."""
    o = z
    for layer in point.layers:
        o = layer(o)
    return point.terms(z, o if point.layers else ca.SX(0, 1), p)


@pytest.mark.parametrize("name", CASES)
def test_first_derivatives_equal_those_of_the_composed_graph(name):
    point, p, made = built(name)
    z, parameters, along = ca.SX.sym("z", point.n_z), ca.SX.sym("p", len(p)), ca.SX.sym("along", point.n_z)
    cost, rows = composed(point, z, parameters)
    direct = [cost, rows, ca.gradient(cost, z), ca.jtimes(rows, z, along)]
    reference = ca.Function("reference", [z, parameters, along], direct)
    for seed in SEEDS:
        generator = np.random.default_rng(seed)
        at, direction = random_point(case(name)[0], point, generator), generator.uniform(-1, 1, point.n_z)
        expected = [np.array(part) for part in reference(at, p, direction)]
        *values, slope, jacobian = (np.array(part) for part in made.first(at, p))
        for value, exact in zip((*values, slope, jacobian @ direction[:, None]), expected, strict=True):
            assert_allclose(value, exact, **SAME)
        for value, exact in zip(made.value(at, p), expected, strict=False):
            assert_allclose(np.array(value), exact, **SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_second_derivatives_equal_those_of_the_composed_graph(name):
    point, p, made = built(name)
    z, parameters, along = ca.SX.sym("z", point.n_z), ca.SX.sym("p", len(p)), ca.SX.sym("along", point.n_z)
    sigma, multiplier = ca.SX.sym("sigma"), ca.SX.sym("lambda", point.n_rows)
    cost, rows = composed(point, z, parameters)
    slope = ca.gradient(sigma * cost + ca.dot(multiplier, rows), z)
    inputs = [z, parameters, sigma, multiplier, along]
    reference = ca.Function("reference", inputs, [ca.jtimes(slope, z, along)])
    for seed in SEEDS:
        generator = np.random.default_rng(seed)
        at, direction = random_point(case(name)[0], point, generator), generator.uniform(-1, 1, point.n_z)
        weights = generator.uniform(-1, 1, point.n_rows)
        lower = np.array(made.second(at, p, 1.3, weights))
        assert_allclose(np.triu(lower, 1), 0.0)
        symmetric = lower + np.tril(lower, -1).T
        expected = np.array(reference(at, p, 1.3, weights, direction)).ravel()
        assert_allclose(symmetric @ direction, expected, **SAME)


@pytest.mark.parametrize("name", FREE_FLYING)
def test_base_axes_give_the_values_of_world_axes(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, TERMS)
    plain, plain_p = point_of(robot, contacts, TERMS, PlainContext)
    assert (len(point.layers), len(plain.layers)) == (4, 2)
    assert_allclose(p, plain_p)
    first, second = Derivatives(point).value, Derivatives(plain).value
    turned = slice(6, 6 + sum(robot.contact(contact).dimension for contact in contacts))
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        cost, rows = (np.array(part).ravel() for part in first(at, p))
        plain_cost, plain_rows = (np.array(part).ravel() for part in second(at, p))
        rotation = pin.Quaternion(state(robot, contacts, at)[0][3:7]).toRotationMatrix()
        acceleration = rows[turned].reshape(-1, 3) @ rotation.T  # of the contacts: from base to world axes
        assert_allclose(acceleration.ravel(), plain_rows[turned], **SAME)
        rest = np.delete(np.arange(len(rows)), turned)
        assert_allclose([*cost, *rows[rest]], [*plain_cost, *plain_rows[rest]], **SAME)


def state(robot: Robot, contacts: tuple[str, ...], z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pinocchio's (q, v, a) and the wrenches of a point's inputs."""
    coordinates, nv = Coordinates(robot.model), robot.nv
    n4 = 4 * coordinates.n_rotations
    parts = np.split(z, [n4, n4 + nv, n4 + 2 * nv, n4 + 3 * nv])
    q, v, a = (part[0] for part in coordinates.local_to_pinocchio(*(part[None] for part in parts[:4])))
    sizes = np.cumsum([robot.contact(name).dimension for name in contacts])
    return q, v, a, np.split(parts[4], sizes)[:-1] if len(sizes) else []


def jacobian(robot: Robot, name: str, q: np.ndarray) -> np.ndarray:
    contact, data = robot.contact(name), robot.model.createData()
    frame = robot.model.getFrameId(contact.frame)
    return pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[list(contact.rows)]


@pytest.mark.parametrize("name", ["solo12-stance", "solo12-flight", "planar-stance", "sole", "turned"])
def test_base_rows_equal_numeric_dynamics_under_the_contact_wrenches(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, ())
    value = Derivatives(point).value
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        q, v, a, wrenches = state(robot, contacts, at)
        expected = pin.rnea(robot.model, robot.model.createData(), q, v, a)
        for contact, wrench in zip(contacts, wrenches, strict=True):
            expected = expected - jacobian(robot, contact, q).T @ wrench
        n = robot.n_unactuated
        assert_allclose(np.array(value(at, p)[1]).ravel()[:n], expected[:n], **SAME)


@pytest.mark.parametrize("name", ["solo12-stance", "planar-stance", "sole", "turned"])
def test_contact_rows_are_as_large_as_the_numeric_classical_acceleration(name):
    robot, contacts = case(name)
    point, p = point_of(robot, contacts, ())
    value, data = Derivatives(point).value, robot.model.createData()
    for seed in SEEDS:
        at = random_point(robot, point, np.random.default_rng(seed))
        q, v, a, _ = state(robot, contacts, at)
        pin.forwardKinematics(robot.model, data, q, v, a)
        rows = np.array(value(at, p)[1]).ravel()[robot.n_unactuated :]
        start = 0
        for contact in map(robot.contact, contacts):
            frame = robot.model.getFrameId(contact.frame)
            motion = pin.getFrameClassicalAcceleration(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            for part in (range(3), range(3, 6)):  # linear, angular: axes may be turned, lengths are not
                taken = [row for row in contact.rows if row in part]
                length = np.linalg.norm(rows[start : start + len(taken)])
                assert_allclose(length, np.linalg.norm(motion.vector[taken]), **SAME)
                start += len(taken)


def test_terms_without_the_robot_need_no_layers():
    robot = robots.load("ur5")
    point, p = point_of(robot, (), (AccelerationCost(weight=2.0), PositionLimits()))
    assert point.layers == ()
    at = random_point(robot, point, np.random.default_rng(0))
    expected = 2.0 * np.mean((at[12:] / Units(robot).acceleration) ** 2)
    assert float(Derivatives(point).value(at, p)[0]) == pytest.approx(expected)


def test_contact_rows_vanish_for_nobody_in_contact():
    robot, context = hopper(), Context(hopper(), Coordinates(hopper().model), (), node=False)
    assert ContactAcceleration().rows(context, Units(robot)) is None


def test_second_derivatives_of_a_quadruped_in_stance_stay_small():
    *_, made = built("solo12-stance")
    assert _engine.Tape(made.second).statements < STANCE_STATEMENTS
