"""Between collocation points: the interpolated motion, constraints broken; and how motions compare."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support import models
from tests.support.problems import SCHEME_ORDERS, hop, landing, reach, still
from tests.support.symbolic_interpolation import SymbolicInterpolation
from tests.support.synthetic_motions import arm_motion, sampled, standing, tumbling_flight, with_meta
from trajopt.certify.accuracy.comparison import compare
from trajopt.certify.accuracy.measures import measure
from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.errors import InputError
from trajopt.motion.configurations import sample_interval
from trajopt.motion.local_states import local_state, state_from_local
from trajopt.motion.solution import Solution
from trajopt.robot.natural_units import NaturalUnits
from trajopt_library import robots

ROUNDING = 1e-12
# Accelerations of order 1e2, of which the symbolic coordinates are read and evaluated by other formulas.
ACCELERATION = 1e-10
INTERVALS = 10


@lru_cache
def standing_dog() -> Solution:
    solo = robots.load("solo12")
    return sampled(solo, [standing(solo), tumbling_flight(solo)], INTERVALS)


@lru_cache
def arm() -> Solution:
    return sampled(robots.load("ur5"), [arm_motion(robots.load("ur5"))], INTERVALS)


@pytest.mark.parametrize("kind", [*models.JOINT_KINDS, "solo12", "go2_planar"])
def test_local_states_are_inverted(kind):
    known = kind in models.ROBOTS
    model = (models.robot if known else models.hand_built)(kind)[0]
    start, _, _ = models.random_state(model, 1)
    q, v, a = models.random_state(model, 2)
    q = pin.integrate(model, start, 0.5 * pin.difference(model, start, q))
    back = state_from_local(model, start, *local_state(model, start, q, v, a))
    assert_allclose(pin.difference(model, q, back[0]), 0.0, atol=ROUNDING)
    assert_allclose(back[1], v, atol=ROUNDING)
    assert_allclose(back[2], a, atol=ACCELERATION)


@pytest.mark.long
@pytest.mark.parametrize("scheme", [*SCHEME_ORDERS, "velocity"])
def test_interpolation_is_that_of_the_symbolic_coordinates(scheme):
    """The same polynomials, read and evaluated by the transcription's own symbolic coordinates."""
    if scheme == "velocity":
        plan = trajopt.solve(still(), intervals=4)
    else:
        plan = trajopt.solve(hop(), intervals=6, transcription=scheme, max_iterations=5)
    other = SymbolicInterpolation(plan)
    fractions = np.array([0.0, 0.3, 0.75, 1.0])
    for number in (0, plan.n_intervals - 1):
        found = sample_interval(plan, number, fractions)
        start, end = plan.interval_t[number]
        for index, fraction in enumerate(fractions):
            expected = other.sample(number, start + fraction * (end - start))
            assert_allclose(pin.difference(plan.model, expected.q, found.q[index]), 0.0, atol=1e-9)
            assert_allclose(found.v[index], expected.v, atol=1e-9, rtol=1e-9)
            assert_allclose(found.a[index], expected.a, atol=ACCELERATION, rtol=ACCELERATION)
            assert_allclose(found.f[index], expected.f, atol=1e-9, rtol=1e-9)


def test_interpolation_passes_through_the_samples():
    """Through a at points alone: there the file's own polynomial of a begins, and q and v have another."""
    plan = trajopt.solve(landing(), intervals=8)
    for number, rows in enumerate(plan.intervals):
        start, end = plan.interval_t[number]
        own = slice(rows.start, rows.stop)
        found = sample_interval(plan, number, (plan.t[own] - start) / (end - start))
        points = plan.collocation[own]
        assert_allclose(found.a[points], plan.a[own][points], atol=1e-6)
        for name in ("v", "tau", "f"):
            assert_allclose(getattr(found, name), getattr(plan, name)[own], atol=1e-9, rtol=1e-9)


def test_torque_that_breaks_its_limit_between_points_alone_is_found():
    """One interval's torque is a straight line through its two points, which ends beyond them."""
    plan = arm()
    rows = plan.intervals[4]
    tau = plan.tau.copy()
    tau[rows.start : rows.stop, 2] = 1e3 * (
        plan.t[rows.start : rows.stop] - plan.t[rows.start : rows.stop].mean()
    )
    at_points = np.abs(tau[plan.collocation]).max(axis=0)
    assert np.argmax(np.abs(tau[plan.collocation, 2])) // 2 == 4
    found = measure(with_meta(replace(plan, tau=tau), effort_limit=at_points.tolist()))
    beyond = np.abs(tau[rows.start, 2]) / at_points[2] - 1  # the first node, where the line is farthest
    assert found.violations["effort"] == pytest.approx(beyond, rel=1e-9)
    assert found.violation_between == found.violations["effort"]


@pytest.mark.long
def test_positions_velocities_and_depths_are_looked_at_between_samples():
    """Limits of positions hold at nodes: on a coarse mesh a joint passes its limit between them."""
    plan = trajopt.solve(landing(), intervals=8)
    assert trajopt.check(plan).position_excess < 1e-6 < measure(plan).violations["position"]
    slower = with_meta(plan, velocity_limit=(0.5 * np.abs(plan.v).max(axis=0)).tolist())
    assert measure(slower).violations["velocity"] >= 1.0 - 1e-9
    raised = with_meta(plan, terrain={**plan.meta["terrain"], "height": 0.01})
    length = NaturalUnits.of(plan.model).length
    before, after = (measure(each).violations["penetration"] * length for each in (plan, raised))
    assert before >= trajopt.check(plan).penetration * (1 - 1e-9) > 0
    assert after == pytest.approx(before + 0.01)


def test_constraints_that_a_robot_has_not_are_none():
    found = measure(arm()).violations
    assert found["friction"] is None
    assert found["drive_torque"] is None
    assert found["obstacle"] is None


def test_friction_between_points_is_over_the_weight():
    plan = standing_dog()
    f = plan.f.copy()
    rows = plan.phase == 0
    f[rows, 0, 0] += 20.0
    units = NaturalUnits.of(plan.model)
    found = measure(replace(plan, f=f))
    beyond = (np.linalg.norm(f[0, 0, :2]) - 0.7 * f[0, 0, 2]) / units.weight
    assert found.violations["friction"] == pytest.approx(beyond, rel=1e-9)
    assert found.phases[1].violation < beyond


def test_drift_of_feet_between_points_is_at_least_that_at_samples():
    plan = trajopt.solve(landing(), intervals=6)
    found = measure(plan)
    assert found.foot_drift >= trajopt.check(plan).foot_drift * (1 - 1e-9)


def test_units_of_prismatic_and_revolute_rows_are_force_and_moment():
    model = trajopt.solve(landing(), max_iterations=0, intervals=6).model
    units = NaturalUnits.of(model)
    force, moment = units.weight, units.weight * units.length
    assert_allclose(units.generalized_force(model), [force] * 3 + [moment] * 3 + [moment, force])


def test_points_of_a_robot_move_as_their_velocities_say():
    model = robots.load("solo12").model
    q, v, _ = models.random_state(model, 3)
    points, step = NamedPoints.of(model), 1e-6
    ahead, behind = (points.positions(pin.integrate(model, q, sign * step * v)) for sign in (1, -1))
    assert_allclose(points.velocities(q, v), (ahead - behind) / (2 * step), atol=1e-8)


def test_a_solution_is_at_no_distance_from_itself():
    found = compare(standing_dog(), standing_dog())
    assert (found.objective_gap, found.distance, found.torque, found.time) == (0.0, 0.0, 0.0, 0.0)


def test_shifted_turned_and_slower_motions_are_that_far_apart():
    plan = standing_dog()
    q = plan.q.copy()
    q[:, 0] += 0.01
    assert compare(replace(plan, q=q), plan).distance == pytest.approx(0.01)
    still_dog = sampled(robots.load("solo12"), [standing(robots.load("solo12"))], 2)
    turned = np.array([_turned(row, 0.02) for row in still_dog.q])
    found = compare(replace(still_dog, q=turned), still_dog)
    assert found.orientation == pytest.approx(0.02, rel=1e-6)
    assert found.distance < 1e-9 < 1e-3 < found.farthest
    slower = replace(plan, t=2 * plan.t, interval_t=2 * plan.interval_t, v=plan.v / 2, a=plan.a / 4)
    found = compare(slower, plan)
    assert found.time == pytest.approx(plan.t[plan.phases[0].stop - 1])
    assert found.distance < 1e-9  # at equal fractions they are at equal places


def _turned(q: np.ndarray, angle: float) -> np.ndarray:
    found = q.copy()
    turn = pin.Quaternion(pin.utils.rotate("z", angle))
    found[3:7] = (turn * pin.Quaternion(q[3:7])).coeffs()
    return found


def test_objective_is_compared_with_its_sign():
    plan = with_meta(standing_dog(), objective=2.0)
    assert compare(with_meta(plan, objective=1.9), plan).objective_gap == pytest.approx(-0.05)
    assert compare(with_meta(plan, objective=None), plan).objective_gap is None
    assert compare(plan, with_meta(plan, objective=-4.0)).objective_gap == pytest.approx(1.5)


def test_torques_are_compared_over_weight_times_reach():
    plan = arm()
    units = NaturalUnits.of(plan.model)
    found = compare(replace(plan, tau=plan.tau + 3.0), plan)
    assert found.torque == pytest.approx(3.0 / (units.weight * units.length))
    assert found.torque_rms == pytest.approx(found.torque)


def test_motions_on_different_meshes_agree_to_their_errors():
    coarse, fine = (
        trajopt.solve(reach(gravity=True), intervals=n, transcription=scheme)
        for n, scheme in ((8, "legendre:2"), (16, "radau:3"))
    )
    assert compare(coarse, fine).distance < 1e-4


def test_reference_of_another_robot_or_with_other_phases_is_refused():
    with pytest.raises(InputError, match="another robot"):
        measure(standing_dog(), arm())
    solo = robots.load("solo12")
    other = sampled(solo, [tumbling_flight(solo), standing(solo)], 2)
    with pytest.raises(InputError, match="other phases; contacts by phase: FL_FOOT"):
        measure(standing_dog(), other)
    with pytest.raises(InputError, match="another actuation"):
        measure(with_meta(arm(), actuation="velocity"), arm())
