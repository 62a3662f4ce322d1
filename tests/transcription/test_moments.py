"""Rows at moments of phases, and the guess of all unknowns from a motion and its perturbation."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.derivatives import assert_derivatives
from tests.support.models import hand_built, random_state
from tests.support.problems import FOOT, SCHEME_ORDERS, hop, hopper, landing, one_phase, reach
from trajopt import InputError, Problem, Robot, Solution
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.samples import sample_quantities
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare, solve
from trajopt.terms.moments import ForceSide, JointSide, LinkDistance, MomentConstraint, PlaneSide
from trajopt.transcription import transcribe
from trajopt.transcription.guess import initial_guess, perturbed
from trajopt.transcription.transcription import Transcription, moments_by_stage
from trajopt_library import problems

# The file's motion is the transcription's own interpolant: rounding, in natural units.
ROUNDING = 1e-9
FRACTIONS = np.array([0.0, 0.13, 0.5, 0.77, 1.0])


def sides(phase: str, seed: int = 0) -> tuple[MomentConstraint, ...]:
    """Foot beyond planes of the world and of a frame, and a point of the world beyond planes of the foot."""
    draw = np.random.default_rng(seed)
    normals = draw.normal(size=(len(FRACTIONS), 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    parameters = np.column_stack(
        [draw.normal(0.0, 0.1, normals.shape), normals, draw.normal(0.0, 0.1, len(FRACTIONS))]
    )
    pairs = ((FOOT, None), (FOOT, "universe"), (None, FOOT))
    return tuple(
        PlaneSide(during=phase, fractions=FRACTIONS, parameters=parameters, frame=frame, body=body)
        for frame, body in pairs
    )


def with_terms(problem: Problem, *terms: MomentConstraint) -> Problem:
    return replace(problem, terms=(*problem.terms, *terms))


def height(problem: Problem, term: PlaneSide, index: int, q: np.ndarray) -> float:
    """The row by numeric Pinocchio, m."""
    model = problem.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    x, normal, offset = np.split(term.parameters[index], [3, 6])
    if term.frame is not None:
        x = data.oMf[model.getFrameId(term.frame)].act(x)
    if term.body is not None:
        x = data.oMf[model.getFrameId(term.body)].actInv(x)
    return float(normal @ x - offset[0])


def rows_of(problem: Problem, solution: Solution, names: set[str]) -> list[tuple[int, int, float]]:
    """(term, moment, scaled row) of a solution of a problem without these terms."""
    prepared = prepare(problem, mesh=None, start=solution, **grid_of(solution))
    t = prepared.transcription
    values = np.asarray(prepared.nlp.engine.g(prepared.guess))
    own = [k for k in range(t.n_rows) if t.rows.names[t.rows.block[k]] in names]
    places = [m for k in range(t.layout.n_stages) for m in moments_by_stage(problem, t.layout).get(k, [])]
    assert len(own) == len(places)
    return [(m.term, m.index, values[row]) for m, row in zip(places, own, strict=True)]


def grid_of(solution: Solution) -> dict[str, object]:
    return {"transcription": solution.statistics.transcription, "intervals": sum(solution.meta["intervals"])}


@pytest.mark.long
@pytest.mark.parametrize("scheme", SCHEME_ORDERS)
def test_a_row_is_that_of_the_interpolated_motion(scheme):
    problem = landing(free=True)
    solution = solve(problem, transcription=scheme, intervals=9)
    terms = [term for phase in problem.schedule.names for term in sides(phase)]
    motion, length = SolutionMotion(solution), problem.robot.length
    for number, index, value in rows_of(with_terms(problem, *terms), solution, {term.name for term in terms}):
        term = terms[number]
        phase = problem.schedule.names.index(term.during)
        (q,) = motion.in_phase(np.array([phase]), term.fractions[[index]], 0.5).q
        assert_allclose(value * length, height(problem, term, index, q), atol=ROUNDING)


def test_joint_and_force_rows_are_those_of_the_motion_in_true_time():
    problem = landing(free=True)
    solution = solve(problem, transcription="legendre:3", intervals=9)
    ones = np.column_stack([-np.ones(5), np.full(5, -3.0)])
    terms = [
        JointSide(during="flight", fractions=FRACTIONS, parameters=ones, joint="hip", rate=True),
        JointSide(during="flight", fractions=FRACTIONS, parameters=ones, joint="shank"),
        ForceSide(
            during="landing", fractions=FRACTIONS, parameters=np.tile([-1.0, 0.0, 0.7], (5, 1)), contact=FOOT
        ),
    ]
    motion, robot = SolutionMotion(solution), problem.robot
    names = {"velocity_between", "position_between", "friction_between"}
    for number, index, value in rows_of(with_terms(problem, *terms), solution, names):
        at = motion.in_phase(np.array([1 if number < 2 else 2]), FRACTIONS[[index]], 0.5)
        time = np.sqrt(robot.length / 9.81)
        expected = (
            (3.0 - at.v[0, 6]) * time,
            (3.0 - at.q[0, -1]) / robot.length,
            terms[2].parameters[index] @ at.f[0, 0, :3] / robot.weight,
        )[number]
        assert_allclose(value, expected, atol=1e-7)


@pytest.mark.parametrize("scheme", ["legendre:2", "radau:3", "hermite-simpson"])
def test_derivatives_equal_differences(scheme):
    cubic = LinkDistance(
        during="flight",
        joints=("hip", "shank"),
        fractions=FRACTIONS,
        parameters=np.random.default_rng(3).normal(size=(len(FRACTIONS), 12)),
    )
    problem = with_terms(hop(), *sides("stance"), *sides("landing", 1), cubic)
    assert_derivatives(prepare(problem, transcription=scheme, intervals=6).nlp, seed=2)


def test_a_bound_holds_at_the_moment_with_every_solver():
    free = reach()
    limit = 0.5 * float(solve(free).v[:, 0].max())
    term = JointSide(
        during="reach",
        fractions=np.linspace(0.05, 0.95, 37),
        parameters=np.tile([-1.0, -1.6 * limit], (37, 1)),
        joint="joint",
        rate=True,
    )
    solution = solve(with_terms(free, term), transcription="legendre:3", intervals=6)
    assert solution.success
    motion = SolutionMotion(solution)
    rates = motion.in_phase(np.zeros(len(term.fractions), dtype=int), term.fractions, 0.5).v[:, 0]
    assert max(rates) <= 1.6 * limit * (1 + 1e-6)


def test_moments_at_a_fixed_start_are_left_out_and_nodes_belong_to_the_later_interval():
    problem = with_terms(hop(), *sides("stance")[:1])
    transcribed = prepare(problem).transcription
    found = moments_by_stage(problem, transcribed.layout)
    assert 0.0 not in [m.fraction for m in found.get(0, [])]
    assert sum(len(own) for own in found.values()) == len(FRACTIONS) - 1


ONE = {"during": "flight", "fractions": [0.2]}


def plane(**changes: object) -> PlaneSide:
    given = {**ONE, "parameters": np.ones((1, 7)), "frame": FOOT, "body": None}
    return PlaneSide(**(given | changes))


def refused(term: MomentConstraint) -> None:
    prepare(with_terms(hop(), term))


BAD = {
    "fraction": lambda: plane(fractions=[1.2]),
    "shape": lambda: plane(parameters=np.ones((1, 6))),
    "length": lambda: plane(parameters=np.ones((2, 7))),
    "NaN": lambda: plane(parameters=np.full((1, 7), np.nan)),
    "world": lambda: plane(frame=None),
    "phase": lambda: refused(plane(during="fly")),
    "joint": lambda: refused(JointSide(**ONE, parameters=np.ones((1, 2)), joint="base")),
    "contact": lambda: refused(ForceSide(**ONE, parameters=np.ones((1, 3)), contact=FOOT)),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_constraint_is_refused(case):
    with pytest.raises(InputError):
        BAD[case]()


GUESS_ROUNDING = 1e-14
# Wrenches carry the motion exactly; the points of the collocation map lie off it by its curvature in
# an interval, which costs this part of the weight.
BASE_RESIDUAL = 2e-2
# The motion's own differences of step 1e-3: error of order 1e-6 of its fourth derivative.
DIFFERENCES = 1e-4


@lru_cache
def jump(name: str = "legendre:2") -> Transcription:
    return transcribe(problems.load("solo12-jump"), name, 9)


def test_guess_carries_the_robot_in_stance():
    t = jump()
    solution = extract(t, initial_guess(t))
    samples, robot = sample_quantities(solution), t.problem.robot
    stance = solution.collocation & (solution.phase == 0)
    assert solution.active[stance].all()
    base = samples.generalized_force[stance, : robot.n_unactuated]
    assert_allclose(base / robot.weight, 0.0, atol=BASE_RESIDUAL)


def test_a_guess_whose_time_is_over_stays_where_it_is():
    made, times = problems.load("solo12-jump"), []

    def slow(t: float) -> np.ndarray:
        times.append(t)
        return made.guess(t)

    t = transcribe(replace(made, guess=slow), "legendre:2", 9)
    times.clear()
    x = initial_guess(t, deadline=-np.inf)
    assert len(times) <= 4  # at one node or point, with its neighbours
    assert np.isfinite(x).all()
    middle = t.layout.node(t.layout.n_stages // 2)
    assert_allclose(x[middle], x[t.layout.node(t.layout.n_stages)], atol=GUESS_ROUNDING)


def test_guess_starts_at_the_start_and_has_unit_quaternions():
    t = jump()
    x = initial_guess(t) * t.scale
    layout, problem = t.layout, t.problem
    start = layout.coordinates.node_from_pinocchio(problem.initial_q, problem.initial_v)
    assert_array_equal(x[layout.node(0)], start)
    norms = [np.linalg.norm(x[layout.node(k)][:4]) for k in range(layout.n_intervals + 1)]
    assert_allclose(norms, 1.0, atol=GUESS_ROUNDING)


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_guess_follows_the_motion_at_nodes(name):
    t = transcribe(hop(guess=tumbling_motion), name, 7)
    x, layout, model = initial_guess(t) * t.scale, t.layout, hopper().model
    nodes = np.array([x[layout.node(k)] for k in range(1, layout.n_intervals + 1)])
    q, v = layout.coordinates.node_to_pinocchio(nodes)
    for row, time in enumerate(layout.node_times[1:]):
        apart = pin.difference(model, tumbling_motion(time), q[row])
        assert_allclose(apart, 0.0, atol=1e-12)
        assert_allclose(v[row], TURNING, atol=DIFFERENCES)


TURNING = np.array([0.3, -0.2, 0.1, 1.0, -4.0, 2.0, 0.4, 0.05])


def tumbling_motion(t: float) -> np.ndarray:
    """A motion of constant body-frame velocity, through more than half a turn."""
    return pin.integrate(hopper().model, hopper().reference, t * TURNING)


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_accelerations_at_a_kink_are_those_of_the_interval(name):
    model, n = hopper().model, 7
    t = transcribe(hop(guess=tumbling_motion), name, n)
    layout, interval = t.layout, 3
    points = layout.scheme_of(layout.stages[interval].phase).c
    kink = float(layout.node_times[interval] + points[-1] * layout.steps[interval])

    def bent(time: float) -> np.ndarray:
        return pin.integrate(model, tumbling_motion(min(time, kink)), max(time - kink, 0.0) * FASTER)

    x = initial_guess(transcribe(hop(guess=bent), name, n)) * t.scale
    phase, window = layout.stages[interval].phase, x[layout.window(interval)]
    found = [window[layout.local_derivative(phase, i)] for i in range(len(points))]
    # the change of the rate over the time between points, times what a polynomial overshoots
    assert np.abs(found).max() < 20 * np.abs(FASTER - TURNING).max() / layout.steps[interval]


FASTER = np.array([0.3, -0.2, 0.1, 1.0, -4.0, 2.0, 3.4, 0.05])


def test_quaternions_and_turns_of_the_guess_continue_from_node_to_node():
    t = transcribe(hop(guess=tumbling_motion), "legendre:1", 12)
    x, layout = initial_guess(t), t.layout
    quaternions = np.array([x[layout.node(k)][:4] for k in range(13)])
    assert np.all(np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0.5)


def test_angle_of_a_continuous_joint_is_counted_through_whole_turns():
    model, _ = hand_built("RUBX")
    robot = Robot.from_model(model, name="spinning")
    start, _, _ = random_state(model, 0)
    turning = np.array([0.0, 9.0, 0.0])
    given = {"initial_v": turning, "guess": lambda t: pin.integrate(model, start, t * turning)}
    problem = one_phase(robot, duration=2.0, initial_q=start, **given)
    t = transcribe(problem, "legendre:1", 10)
    x, layout = initial_guess(t) * t.scale, t.layout
    angles = [x[layout.node(k)][layout.forms[0].additive[1]] for k in range(11)]
    assert_allclose(np.diff(angles), 9.0 * 0.2, atol=1e-9)


def test_arm_needs_no_wrench_and_follows_the_motion():
    t = transcribe(reach(), "legendre:2", 5)
    x, layout = initial_guess(t) * t.scale, t.layout
    assert layout.n_wrench(0) == 0
    assert_allclose(x[layout.node(5)][0], reach().guess(0.8))


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_perturbation_keeps_what_is_fixed_and_unit_quaternions(sigma):
    t = jump()
    x = initial_guess(t)
    moved = perturbed(t, x, 4, sigma)
    fixed = t.lower_x == t.upper_x
    assert fixed.sum() == t.layout.forms[0].size
    assert_allclose(moved[fixed], x[fixed], atol=GUESS_ROUNDING)
    norms = [np.linalg.norm(moved[t.layout.node(k)][:4]) for k in range(t.layout.n_intervals + 1)]
    assert_allclose(norms, 1.0, atol=GUESS_ROUNDING)
    assert np.std((moved - x)[~fixed]) == pytest.approx(sigma, rel=0.1)


def test_perturbation_is_reproducible_by_its_seed():
    t = jump()
    x = initial_guess(t)
    assert_array_equal(perturbed(t, x, 4, 0.1), perturbed(t, x, 4, 0.1))
    assert np.max(np.abs(perturbed(t, x, 4, 0.1) - perturbed(t, x, 5, 0.1))) > 0.1
    assert_array_equal(x, initial_guess(t))
