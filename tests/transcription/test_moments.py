"""Rows at moments of phases: values of the interpolated motion, derivatives, and what they hold."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.derivatives import assert_derivatives
from tests.support.problems import FOOT, SCHEME_ORDERS, hop, landing, reach
from trajopt.errors import InputError
from trajopt.motion.configurations import SolutionMotion
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.solving.solving import prepare, solve
from trajopt.terms.moments import ForceSide, JointSide, LinkDistance, MomentConstraint, PlaneSide
from trajopt.transcription.transcription import moments_by_stage

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
