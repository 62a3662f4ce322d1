"""Steps of the interior point: optima of IPOPT, soft rows, structure that stays, numbers in place."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from trajopt import _engine
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.nlp import Nlp, assemble
from trajopt.transcription.transcription import transcribe

SMALL_BARRIER = 1e-9
SAME_OPTIMUM = 1e-6


def nlp_of(name: str, **settings: object) -> Nlp:
    t = transcribe(trajopt.load(name, **settings))
    compiled, _ = compile_points(t.points.values())
    return assemble(t, {key: compiled[entry_key(point)] for key, point in t.points.items()})


def solver_of(nlp: Nlp) -> tuple[_engine.InteriorPoint, tuple[np.ndarray, ...]]:
    t = nlp.transcription
    bounds = t.lower_x, t.upper_x, t.lower_g, t.upper_g
    return _engine.InteriorPoint(nlp.engine, *bounds, t.layout.stage_numbers), bounds


@pytest.fixture(scope="module")
def reach() -> Nlp:
    return nlp_of("ur5-reach")


@pytest.mark.long
@pytest.mark.parametrize("name", ["ur5-reach", "quadruped-stand-up"])
def test_many_steps_end_in_the_optimum_of_ipopt(name: str) -> None:
    nlp = nlp_of(name)
    solver, bounds = solver_of(nlp)
    t = nlp.transcription
    best = _engine.solve_ipopt(nlp.engine, initial_guess(t), *bounds, {"tol": 1e-9}, None)
    iterate = solver.complete(best["x"], best["lam_g"], *bounds, 1e-4, 1e-4)
    soft = np.zeros(t.n_rows)
    for barrier in (1e-4, 1e-6, SMALL_BARRIER):
        iterate, reports = solver.steps(
            iterate, *bounds, soft, barrier, 1e-2, tolerance=1e-2 * barrier, steps=60
        )
    assert max(reports[-1][key] for key in ("primal", "dual", "complementarity")) < SMALL_BARRIER
    assert_allclose(nlp.engine.f(iterate["x"]), best["f"], rtol=SAME_OPTIMUM, atol=SAME_OPTIMUM)
    held = iterate["x"][t.lower_x == t.upper_x]
    assert_array_equal(held, t.lower_x[t.lower_x == t.upper_x])


def test_a_soft_row_is_missed_by_its_compliance_times_its_multiplier(reach: Nlp) -> None:
    """A start that no motion reaches the goal from in time: rows of the goal give way, others hold."""
    solver, _ = solver_of(reach)
    t = reach.transcription
    fixed = np.flatnonzero(t.lower_x == t.upper_x)
    lower, upper = t.lower_x.copy(), t.upper_x.copy()
    lower[fixed] += 0.05
    upper[fixed] += 0.05
    bounds = lower, upper, t.lower_g, t.upper_g
    soft = np.full(t.n_rows, 1e-2)
    iterate = solver.complete(initial_guess(t), np.zeros(t.n_rows), *bounds, 1e-3, 1e-2)
    iterate, reports = solver.steps(iterate, *bounds, soft, 1e-3, 1e-1, tolerance=1e-9, steps=80)
    assert reports[-1]["primal"] < 1e-8
    g, equal = reach.engine.g(iterate["x"]), t.lower_g == t.upper_g
    assert_allclose(g[equal] - t.lower_g[equal], soft[equal] * iterate["y"][equal], atol=1e-8)


def test_steps_are_the_same_whatever_was_solved_before(reach: Nlp) -> None:
    solver, bounds = solver_of(reach)
    t = reach.transcription
    soft, zero = np.zeros(t.n_rows), np.zeros(t.n_rows)
    start = solver.complete(initial_guess(t), zero, *bounds, 1e-3, 1e-2)
    first, _ = solver.steps(start, *bounds, soft, 1e-3, 1e-2, steps=3)
    solver.steps(first, *bounds, soft, 1e-4, 1e-2, steps=20)
    other, _ = solver_of(reach)
    again, _ = other.steps(start, *bounds, soft, 1e-3, 1e-2, steps=3)
    for key in ("x", "s", "y", "lower_x", "upper_s"):
        assert_array_equal(first[key], again[key])


def test_a_solver_takes_only_the_structure_that_it_was_made_for(reach: Nlp) -> None:
    solver, bounds = solver_of(reach)
    t = reach.transcription
    iterate = solver.complete(initial_guess(t), np.zeros(t.n_rows), *bounds, 1e-3, 1e-2)
    free = np.flatnonzero(t.lower_x < t.upper_x)[0]
    lower, upper = t.lower_x.copy(), t.upper_x.copy()
    lower[free] = upper[free] = 0.0
    with pytest.raises(ValueError, match="bounds fix other variables"):
        solver.steps(iterate, lower, upper, t.lower_g, t.upper_g, np.zeros(t.n_rows), 1e-3, 1e-2)
    with pytest.raises(ValueError, match="compliance has a wrong size"):
        solver.steps(iterate, *bounds, np.zeros(3), 1e-3, 1e-2)
    with pytest.raises(ValueError, match="an iterate needs 's'"):
        solver.steps({**iterate, "s": np.zeros(1)}, *bounds, np.zeros(t.n_rows), 1e-3, 1e-2)
    with pytest.raises(ValueError, match="barrier must be positive"):
        solver.steps(iterate, *bounds, np.zeros(t.n_rows), 0.0, 1e-2)


def test_numbers_of_a_group_have_the_sizes_that_it_was_made_with(reach: Nlp) -> None:
    group = reach.parts["groups"][0]
    names = ("gather_data", "p", "cost_weight", "jac_coef", "hess_coef")
    given = {name: np.ravel(group[name]) for name in names}
    reach.engine.set_group(0, **given)
    with pytest.raises(ValueError, match="other sizes"):
        reach.engine.set_group(0, **{**given, "p": np.zeros(1)})
    with pytest.raises(ValueError, match="no such group"):
        reach.engine.set_group(99, **given)
    with pytest.raises(ValueError, match="other sizes"):
        reach.engine.set_linear(np.zeros(1), np.zeros(1))
