"""Every public cost and constraint: its value, derivatives, units and bounds, and what is refused."""

import dataclasses
import inspect
import math
import re
from functools import cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.problems import FOOT, REACH_TIME, hopper, reach
from tests.terms.term_cases import CASES, UP, goal, limited_arm
from tests.terms.term_points import Evaluated, Scale, similar
from trajopt import InputError, Phase, Schedule, Solution, terms
from trajopt.dynamics import contact_jacobian
from trajopt.solving.solving import solve
from trajopt.terms import Cost, NodeConstraint, NodeCost, PointConstraint, Rows, free_directions
from trajopt.terrain import Surface

SEEDS = (0, 1, 2)
# Sums of the same numbers of order one in natural units, in another order.
SAME = {"rtol": 1e-9, "atol": 1e-9}
# Central differences of step 1e-5 on functions whose third derivatives are at most about 1e4.
STEP, DIFFERENCES = 1e-5, {"rtol": 1e-5, "atol": 1e-5}
# The solver's tolerance of 1e-6 on scaled rows and multipliers, with one order for conditioning; rad, N m.
SOLVED = 1e-5
SAME_SIZE = Scale()
KINDS = (Cost, NodeCost, PointConstraint, NodeConstraint)
every = pytest.mark.parametrize("name", CASES)
COSTS = [name for name, case in CASES.items() if case.rows is None]
# Terms about contacts alone: without an active one they have no row.
OF_CONTACTS = (
    terms.ContactAcceleration, terms.ContactVelocity, terms.FrictionPyramid, terms.FrictionCone,
    terms.SoleLimits, terms.SoleCone, terms.NormalForce, terms.SlidingFriction, terms.WrenchCost,
    terms.ImpulseCost,
)  # fmt: skip
FRICTION = ("friction pyramid", "friction pyramid on a slope", "friction cone", "sole limits", "sole cone")


@cache
def evaluated(
    name: str, scale: Scale = SAME_SIZE, contact: bool | None = None, **changes: object
) -> Evaluated:
    return Evaluated(CASES[name], scale, contact, changes)


def public_terms() -> set[type]:
    found = (getattr(terms, name) for name in dir(terms))
    return {
        each
        for each in found
        if inspect.isclass(each) and issubclass(each, KINDS) and not inspect.isabstract(each)
    }


def test_every_public_term_has_a_case():
    covered = {type(case.make(Scale())) for case in CASES.values()}
    assert covered == public_terms()


@pytest.mark.parametrize("kind", sorted(public_terms(), key=lambda kind: kind.__name__))
def test_the_docstring_of_a_term_has_its_formula_and_its_arguments(kind):
    text = inspect.getdoc(kind)
    assert re.search(r"\n\n    \S", text), "no formula"
    inherited = {field.name for base in kind.__bases__ for field in dataclasses.fields(base)}
    arguments = {field.name for field in dataclasses.fields(kind)} - inherited
    assert {name for name in arguments if not re.search(rf"\n    {name}: ", text)} == set()


@every
@pytest.mark.parametrize("seed", SEEDS)
def test_value_is_that_of_the_formula(name, seed):
    case, term = CASES[name], evaluated(name)
    z, point = term.point(seed)
    if case.rows is None:
        residual = None if case.residual is None else np.asarray(case.residual(point, term.term))
        expected = case.value(point, term.term) if residual is None else 2.0 * np.mean(residual**2)
        assert_allclose(term.at(z), [expected], **SAME)
        return
    values, lower, upper, unit = (np.asarray(part, dtype=float) for part in case.rows(point, term.term))
    result, n = term.result, len(values)
    unit = np.broadcast_to(unit, n)
    assert_allclose(term.at(z) / unit, values / unit, **SAME)
    assert_allclose(result.unit, unit, **SAME)
    assert_allclose(result.lower, np.broadcast_to(lower, n), **SAME)
    assert_allclose(result.upper, np.broadcast_to(upper, n), **SAME)


@every
def test_derivatives_agree_with_differences(name):
    term = evaluated(name)
    (z, _), generator = term.point(5), np.random.default_rng(5)
    size = np.maximum(np.abs(z), 0.1)
    along = generator.uniform(-1, 1, z.shape) * size
    jacobian = np.array(ca.DM(term.function(z)[1])).reshape(-1, len(z))
    slope = (term.at(z + STEP * along) - term.at(z - STEP * along)) / (2 * STEP)
    unit = term.result.unit if isinstance(term.result, Rows) else 1.0
    assert_allclose(jacobian @ along / unit, slope / unit, **DIFFERENCES)


@every
def test_values_and_derivatives_are_finite_at_rest_without_forces(name):
    z, _ = evaluated(name).point(0, size=0.0)
    for part in evaluated(name).function(z):
        assert np.isfinite(np.array(ca.DM(part))).all()


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.same_on_similar])
@pytest.mark.parametrize("scale", [Scale(length=2.5), Scale(mass=7.0), Scale(length=0.3, mass=0.1)])
def test_natural_units_make_a_term_the_same_on_a_similar_robot(name, scale):
    """At the point of the same numbers in natural units costs are equal, and rows over their units."""
    here, there = evaluated(name), evaluated(name, scale)
    parts = [(term, term.at(term.point(7)[0])) for term in (here, there)]
    if CASES[name].rows is None:
        assert_allclose(parts[1][1], parts[0][1], **SAME)
        return
    (first, second) = [
        [
            values / term.result.unit,
            term.result.lower / term.result.unit,
            term.result.upper / term.result.unit,
        ]
        for term, values in parts
    ]
    for one, other in zip(first, second, strict=True):
        assert_allclose(other, one, **SAME)


@every
def test_bounds_leave_room_and_units_are_positive(name):
    result = evaluated(name).result
    if isinstance(result, Rows):
        assert (result.lower <= result.upper).all()
        assert (np.isfinite(result.lower) | np.isfinite(result.upper)).all()
        assert (result.unit > 0).all()
        assert np.isfinite(result.unit).all()


@pytest.mark.parametrize("name", [n for n in CASES if isinstance(CASES[n].make(Scale()), OF_CONTACTS)])
def test_an_inactive_contact_makes_no_row_and_no_cost(name):
    result = evaluated(name, contact=False).result
    assert result is None or ca.SX(result).is_zero()


@pytest.mark.parametrize("name", COSTS)
def test_a_cost_is_linear_in_its_weight_and_refuses_a_negative_one(name):
    z, _ = evaluated(name).point(3)
    assert_allclose(evaluated(name, weight=6.0).at(z), 3 * evaluated(name).at(z), **SAME)
    assert_allclose(evaluated(name, weight=0.0).at(z), 0.0, **SAME)
    for weight in (-1.0, math.inf):
        with pytest.raises(InputError, match="weight"):
            dataclasses.replace(CASES[name].make(Scale()), weight=weight)


@pytest.mark.parametrize("name", [name for name in COSTS if CASES[name].residual is not None])
def test_gauss_newton_squares_sum_up_to_the_cost(name):
    term = evaluated(name)
    z, _ = term.point(4)
    scale = 1.0 if CASES[name].place.value == "impact" else float(term.context.time_scale.numel() and 1.3)
    term.result  # noqa: B018  makes the cost, which records its squares
    residuals, weights = term.context.squares
    square = Evaluated(term.case)
    square.__dict__.update(context=term.context, result=ca.dot(weights, residuals**2), term=term.term)
    assert_allclose(square.at(z), scale * term.at(z), **SAME)


def _with_nan(value: object) -> object:
    """The value with its first number replaced by NaN; None where it holds none."""
    if isinstance(value, float):
        return math.nan
    if isinstance(value, np.ndarray) or (isinstance(value, tuple) and value and isinstance(value[0], float)):
        array = np.array(value, dtype=float)
        array.flat[0] = math.nan
        return array if isinstance(value, np.ndarray) else tuple(array.tolist())
    return None


NUMBERS = [
    (name, field.name)
    for name, term in ((name, case.make(Scale())) for name, case in CASES.items())
    for field in dataclasses.fields(term)
    if _with_nan(getattr(term, field.name)) is not None
]


@pytest.mark.parametrize(("name", "field"), NUMBERS)
def test_nan_is_refused(name, field):
    term = CASES[name].make(Scale())
    with pytest.raises(InputError):
        dataclasses.replace(term, **{field: _with_nan(getattr(term, field))})


@pytest.mark.parametrize("name", FRICTION)
def test_without_friction_tangential_forces_are_zero_by_equations(name):
    """Inequalities to both sides would leave no interior."""
    term = evaluated(name, friction=0.0)
    rows = term.result
    tangential = {"sole limits": 1, "sole cone": 3}.get(name, 2)
    equations = rows.lower == rows.upper
    assert equations.sum() == tangential
    for seed in SEEDS:
        z, point = term.point(seed)
        wrench = point.wrench
        if point.robot.contacts[0].kind == "surface":
            turn = point.pose(FOOT).rotation
            force, moment = turn.T @ wrench[:3], turn.T @ wrench[3:]
            units = np.array([point.units.force] * 2 + [point.units.torque])
            expected = (np.append(force[:2], moment[2]) / units)[-tangential:]
        else:
            expected = point.on_surface[:2] / point.units.force
        assert_allclose(term.at(z)[equations] / rows.unit[equations], expected, **SAME)


@pytest.mark.parametrize("name", FRICTION)
def test_a_contact_that_is_held_or_slides_has_no_friction_row(name):
    held = Surface(point=np.zeros(3), normal=UP, bilateral=True)
    slides = Surface(point=np.zeros(3), normal=UP, slip_speed=0.1)
    for surface in (held, slides):
        case = dataclasses.replace(CASES[name], surface=lambda scale, surface=surface: surface)
        assert Evaluated(case).result is None


@pytest.mark.parametrize("name", ["position limits", "velocity limits", "torque limits"])
def test_infinite_limits_have_no_row_and_half_infinite_ones_keep_the_other_side(name):
    term = evaluated(name)
    robot = term.robot
    free = np.full(robot.nv, math.inf)
    endless = dataclasses.replace(
        robot,
        velocity_limit=free,
        position_lower=np.full(robot.nq, -math.inf),
        position_upper=np.full(robot.nq, math.inf),
    )
    changes = {"limit": np.full(2, math.inf)} if name == "torque limits" else {}
    case = dataclasses.replace(CASES[name], robot=lambda: endless)
    assert Evaluated(case, changes=changes).result is None
    if name == "position limits":
        case = dataclasses.replace(
            CASES[name], robot=lambda: dataclasses.replace(endless, position_lower=robot.position_lower)
        )
        rows = Evaluated(case).result
        assert_allclose(rows.lower, robot.position_lower[7:])
        assert (rows.upper == math.inf).all()


def test_torques_that_cannot_be_reached_have_no_row():
    term = evaluated("torque limits")
    some = evaluated("torque limits", limit=None)
    far = Evaluated(
        CASES["torque limits"], changes={"limit": np.array([1.0, 2 * term.units.unreachable_torque])}
    )
    assert some.result is not None
    assert len(far.result.lower) == 1


@pytest.mark.parametrize("contacts", [(), (FOOT,)])
@pytest.mark.parametrize("kind", ["point", "surface"])
def test_free_directions_are_those_in_which_no_contact_moves(contacts, kind):
    robot, q = hopper(kind), goal(Scale())
    basis = free_directions(robot, q, contacts)
    held = sum(robot.contact(name).dimension for name in contacts)
    assert basis.shape == (robot.nv, robot.nv - held)
    assert_allclose(basis.T @ basis, np.eye(robot.nv - held), **SAME)
    frames = [(robot.contact(name).frame, robot.contact(name).rows) for name in contacts]
    from_local = np.eye(robot.nv)  # Pinocchio's linear velocity of the base is in its own axes
    from_local[:3, :3] = pin.Quaternion(q[3:7]).toRotationMatrix().T
    assert_allclose(contact_jacobian(robot.model, q, frames) @ from_local @ basis, 0.0, **SAME)


@pytest.mark.parametrize("scale", [Scale(length=2.5), Scale(length=0.3, mass=7.0)])
def test_the_optimum_of_a_similar_robot_is_the_similar_motion(scale):
    """All costs and limits together, from the same guess in natural time."""

    def solved(scale: Scale) -> Solution:
        problem, duration = reach(gravity=True), REACH_TIME * scale.time
        return solve(
            dataclasses.replace(
                problem,
                robot=similar(limited_arm(), scale),
                schedule=Schedule((Phase(name="reach", duration=duration),)),
                guess=lambda t: problem.guess(t / scale.time),
                terms=(
                    *terms.effort_costs(),
                    terms.PowerCost(weight=0.1),
                    terms.TorqueLimits(limit=np.array([8.0 * scale.torque])),
                    *[term for term in problem.terms if isinstance(term, NodeConstraint)],
                ),
            ),
            intervals=10,
        )

    here, there = solved(Scale()), solved(scale)
    assert here.converged
    assert there.converged
    assert_allclose(there.q, here.q, atol=SOLVED)
    assert_allclose(there.tau / scale.torque, here.tau, atol=SOLVED)
