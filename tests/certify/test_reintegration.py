"""Between samples: integration by the check, open-loop errors, broken constraints; comparison of motions."""

import itertools
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import DOP853

import trajopt
from tests.support import models
from tests.support.problems import SCHEME_ORDERS, hop, landing, reach, still
from tests.support.symbolic_interpolation import SymbolicInterpolation
from tests.support.synthetic_motions import arm_motion, sampled, standing, tumbling_flight, with_meta
from trajopt import InputError, Solution, check, solve
from trajopt._numeric import Dynamics
from trajopt.certify import ContactSet
from trajopt.certify.accuracy import compare, interval_errors, measure
from trajopt.certify.accuracy.local_errors import local_errors
from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact_figures import force_traces
from trajopt.certify.reintegration import open_loop
from trajopt.certify.report import Tolerances
from trajopt.certify.runge_kutta import METHOD, integrate
from trajopt.motion.configurations import resampled, sample_interval
from trajopt.motion.local_states import local_state, state_from_local
from trajopt.motion.quantities import MotionQuantities
from trajopt.robot.natural_units import NaturalUnits
from trajopt_library import problems, robots

INTERVALS = 20
EXACT = 1e-9  # motions are integrated to 1e-13; the numbers here are of order one


def test_open_loop_error_of_interpolated_torques_falls_with_the_fourth_power():
    robot = robots.load("ur5")
    coarse, fine = (check(sampled(robot, [arm_motion(robot)], n)).open_loop_joints for n in (20, 40))
    assert np.log2(coarse / fine) == pytest.approx(4, abs=0.3)


def test_wrong_torque_shows_in_the_open_loop(push):
    wrong = replace(push, tau=push.tau + 1e-2)
    assert check(wrong).open_loop_joints > 1e-3


def test_open_loop_runs_phase_by_phase(solo):
    both = sampled(solo, [standing(solo), tumbling_flight(solo)], INTERVALS)
    pushed = replace(both, tau=both.tau + 0.1 * (both.phase == 1)[:, None])
    stance_error, flight_error = (open_loop(MotionQuantities(pushed), phase) for phase in (0, 1))
    assert stance_error.position < EXACT
    assert flight_error.joints > 0.1
    report = check(both)
    assert [phase.contacts for phase in report.phases] == [both.contact_frames, ()]
    assert report.phases[1].ballistic_error < EXACT


def test_an_open_loop_ends_where_its_error_is_more_than_is_asked_for(solo):
    both = sampled(solo, [standing(solo), tumbling_flight(solo)], INTERVALS)
    motion = MotionQuantities(replace(both, tau=both.tau + 0.1 * (both.phase == 1)[:, None]))
    whole = open_loop(motion, 1)
    assert open_loop(motion, 1, most=(0.5 * whole.position, np.inf)) is None
    assert open_loop(motion, 1, most=(np.inf, 0.5 * whole.joints)) is None
    assert open_loop(motion, 1, most=(2 * whole.position, 2 * whole.joints + 2 * whole.orientation)) == whole


def test_a_phase_that_a_verdict_finds_unstable_has_no_figures_of_its_open_loop():
    plan = solve(problems.load("cart-pole"), draft=True)
    (whole,) = check(plan).phases
    assert whole.stable is False
    assert whole.open_loop_joints > whole.local_joints
    (judged,) = check(plan, integrate=False).phases
    assert judged.stable is False
    assert judged.open_loop_joints is None
    assert judged.local_joints == whole.local_joints


@pytest.mark.parametrize("name", ["ur5", "solo"])
def test_compiled_integration_is_that_of_python(name, solo, monkeypatch):
    robot = robots.load("ur5") if name == "ur5" else solo
    parts = [arm_motion(robot)] if name == "ur5" else [standing(solo), tumbling_flight(solo)]
    plan = sampled(robot, parts, INTERVALS)
    motion = MotionQuantities(replace(plan, tau=plan.tau + 0.1))
    phases = range(len(plan.phases))
    compiled = [open_loop(motion, phase) for phase in phases]
    monkeypatch.setattr(ContactDynamics, "compiled", None)
    for one, other in zip(compiled, (open_loop(motion, phase) for phase in phases), strict=True):
        assert one.joints > 1e-3
        assert_allclose(one.joints, other.joints, rtol=EXACT)
        if name == "solo":
            assert_allclose(one.position, other.position, rtol=EXACT, atol=EXACT)


@pytest.mark.parametrize("name", ["talos", "g1", "go2", "ur5"])
def test_compiled_accelerations_are_those_of_python(name):
    robot, generator = robots.load(name), np.random.default_rng(3)
    model, count = robot.model, 20
    near = [
        pin.integrate(model, robot.reference, 0.2 * generator.normal(size=model.nv)) for _ in range(count)
    ]
    states = (
        np.array(near),
        generator.normal(size=(count, model.nv)),
        generator.normal(size=(count, model.nv)),
    )
    dynamics = ContactDynamics(model, ContactSet.of(model, robot.contacts))
    expected = np.array([dynamics.acceleration(*row) for row in zip(*states, strict=True)])
    found = dynamics.compiled.accelerations(*states)
    assert_allclose(found, expected, rtol=EXACT, atol=EXACT * np.abs(expected).max())


def test_dynamics_of_joints_that_follow_others_are_not_compiled():
    ur5 = robots.load("ur5")
    none = ContactSet.of(ur5.model, [])
    assert ContactDynamics(ur5.model, none).compiled is not None
    assert ContactDynamics(ur5.model, none, np.eye(ur5.nv)[:, :-1]).compiled is None


def test_compiled_dynamics_refuse_what_is_no_model_and_shapes_that_do_not_fit():
    model = robots.load("ur5").model
    with pytest.raises(TypeError, match=r"pinocchio\.Model"):
        Dynamics("ur5", [], [], 1.0)
    with pytest.raises(ValueError, match="a frame is not in the model"):
        Dynamics(model, [model.nframes], [3], 1.0)
    with pytest.raises(ValueError, match="dimensions have a wrong size"):
        Dynamics(model, [1], [], 1.0)
    dynamics, rest = Dynamics(model, [], [], 1.0), np.zeros(model.nv)
    with pytest.raises(ValueError, match="q, v or force have a wrong shape"):
        dynamics.accelerations(np.zeros((2, model.nq)), np.zeros((1, model.nv)), np.zeros((2, model.nv)))
    short = METHOD, np.zeros(model.nq - 1), rest, np.zeros((2, 6)), np.eye(6), 0.1, 1e-9, 1e-11, 100
    with pytest.raises(ValueError, match="q has a wrong size"):
        dynamics.integrate(*short)
    few = METHOD, np.zeros(model.nq), rest, np.zeros((2, 6)), np.eye(6), 0.1, 1e-9, 1e-11, 10
    assert dynamics.integrate(*few)[0] is False


def test_torque_that_runs_away_is_reported_as_infinite(flight):
    report = check(replace(flight, tau=flight.tau * 1e12))
    assert report.open_loop_joints == np.inf
    assert report.to_dict()["open_loop_joints"] is None
    assert not report.within(Tolerances(open_loop_joints=1.0))


def pendulum(t: float, state: np.ndarray) -> np.ndarray:
    return np.array([state[1], -9.81 * np.sin(state[0]) + np.cos(3 * t)])


def peers(rate, state, relative: float, absolute: float) -> tuple[np.ndarray, int]:
    """SciPy's result, and its number of evaluations."""
    method = DOP853(rate, 0.0, state, 1.0, rtol=relative, atol=absolute)
    while method.status == "running":
        method.step()
    return method.y, method.nfev


@pytest.mark.parametrize("relative", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("rate_of", [1.0, 30.0])
def test_result_and_evaluations_are_scipys(relative, rate_of):
    counted = itertools.count()

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        next(counted)
        return rate_of * pendulum(rate_of * t, state)

    start = np.array([2.0, -1.0])
    ours = integrate(rate, start, relative=relative, absolute=1e-3 * relative)
    evaluations = next(counted)
    theirs, count = peers(rate, start, relative, 1e-3 * relative)
    assert ours is not None
    assert evaluations == count
    assert_allclose(ours, theirs, rtol=max(1e-12, 1e-4 * relative))  # a pendulum multiplies rounding


def test_error_falls_with_the_eighth_power_of_the_step():
    errors = []
    for steps in (4, 8):
        state = np.array([1.0, 0.0])
        for _ in range(steps):  # a loose bound: each call takes one step
            end = integrate(
                lambda _, s: np.array([s[1], -s[0]]), state, relative=1e3, absolute=1e3, length=2 / steps
            )
            assert end is not None
            state = end
        errors.append(np.abs(state - [np.cos(2), -np.sin(2)]).max())
    assert 7.5 < np.log2(errors[0] / errors[1]) < 9.5


def test_what_grows_without_bound_or_is_no_number_has_no_result():
    def explodes(_: float, state: np.ndarray) -> np.ndarray:
        return state**2

    with np.errstate(over="ignore", invalid="ignore"):
        assert integrate(explodes, np.array([10.0]), relative=1e-6, absolute=1e-9) is None
        assert integrate(lambda _, s: s * np.nan, np.ones(2), relative=1e-6, absolute=1e-9) is None


def test_a_state_at_rest_stays():
    rest = integrate(lambda _, s: 0 * s, np.array([3.0, -1.0]), relative=1e-9, absolute=1e-12)
    assert_allclose(rest, [3.0, -1.0], rtol=0, atol=0)


FINE = np.linspace(0.0, 1.0, 201)
# The worst value differs from that of two hundred samples in each interval by this part of the figure's unit.
FOUND = 2e-3
# An estimate of local errors serves within this factor.
FACTOR = 2.0


@pytest.fixture(scope="module", params=["legendre:2", "legendre:4", "radau:3"])
def plan(request: pytest.FixtureRequest) -> Solution:
    return trajopt.solve(landing(), intervals=8, transcription=request.param)


@pytest.mark.long
def test_worst_of_two_hundred_samples_is_found_with_a_few(plan):
    report, fine = check(plan, integrate=False), resampled(plan.normalized(), FINE)
    motion = MotionQuantities(fine)
    expected = {**force_traces(motion), **motion.limit_traces}
    for name in ("friction_margin", "unilateral_margin", "velocity_excess", "position_excess"):
        worst = expected[name].worst()
        assert worst is not None
        found, sign = getattr(report, f"{name}_between"), -1 if expected[name].margin else 1
        assert sign * found > sign * worst[0] - FOUND, name
        assert sign * found < sign * worst[0] + FOUND, name


@pytest.mark.long
def test_places_are_those_of_the_worst_values(plan):
    report = check(plan, integrate=False)
    place = report.places["friction_margin_between"]
    assert place.phase == "landing"
    assert place.name == "foot"
    number = int(plan.interval_at(place.time))
    start, end = plan.interval_t[number]
    assert start <= place.time <= end


@pytest.mark.long
@pytest.mark.parametrize("problem", [landing(), hop(), reach(gravity=True)], ids=["landing", "hop", "reach"])
def test_local_errors_are_those_of_an_integration(problem):
    plan = trajopt.solve(problem, intervals=12).normalized()
    found = local_errors(MotionQuantities(plan)).position
    expected = interval_errors(plan)
    large = expected > 1e-2 * expected.max()
    assert_allclose(np.log(found[large] / expected[large]), 0.0, atol=np.log(FACTOR))
    assert found.sum() == pytest.approx(expected.sum(), rel=0.5)


@pytest.mark.long
def test_local_errors_of_uneven_meshes_are_in_the_order_of_the_intervals():
    plan = trajopt.solve(landing(), transcription="legendre:2,legendre:2,legendre:3", intervals=8)
    found = local_errors(MotionQuantities.normalized(plan)).position
    assert np.argmax(found) == np.argmax(interval_errors(plan))


ROUNDING = 1e-12
# Accelerations of order 1e2, of which the symbolic coordinates are read and evaluated by other formulas.
ACCELERATION = 1e-10
BETWEEN_INTERVALS = 10


@lru_cache
def standing_dog() -> Solution:
    solo = robots.load("solo12")
    return sampled(solo, [standing(solo), tumbling_flight(solo)], BETWEEN_INTERVALS)


@lru_cache
def arm() -> Solution:
    return sampled(robots.load("ur5"), [arm_motion(robots.load("ur5"))], BETWEEN_INTERVALS)


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
