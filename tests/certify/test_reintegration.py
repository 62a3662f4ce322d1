"""Integration by the check: its Runge-Kutta, open-loop errors, and figures between samples."""

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import DOP853

import trajopt
from tests.support.problems import hop, landing, reach
from tests.support.synthetic_motions import arm_motion, sampled, standing, tumbling_flight
from trajopt._numeric import Dynamics
from trajopt.certify.accuracy.local_errors import local_errors
from trajopt.certify.accuracy.measures import interval_errors
from trajopt.certify.check import check
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.certify.contact_figures import force_traces
from trajopt.certify.reintegration import open_loop
from trajopt.certify.report import Tolerances
from trajopt.certify.runge_kutta import METHOD, integrate
from trajopt.motion.configurations import resampled
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.solution import Solution
from trajopt.solving.graded import solve
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
