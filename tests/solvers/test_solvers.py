"""Solvers on transcribed problems: CasADi's optima, stops, options, threads, and Hessians to choose from."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from tests.support.command_lines import invoke
from tests.support.problems import (
    REACH,
    REACH_TIME,
    hop,
    hopper,
    inertia,
    lean,
    limited_reach,
    one_joint_arm,
    planar_hopper,
    point_of,
    random_point,
    reach,
)
from tests.support.refusals import refused
from trajopt import Problem, Robot, terms
from trajopt.cache import CACHE_VARIABLE
from trajopt.robot import Drive
from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.elastic import CLEAR_VIOLATION, REMOVABLE_VIOLATION, least_violation
from trajopt.solvers.ipopt import IPOPT_OPTIONS
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem, prepare, solve, solve_prepared
from trajopt.solving.stalling import DECREASE, DUAL_LIMIT, START, TAIL, VIOLATION, WINDOW, is_stalled
from trajopt.transcription import Derivatives
from trajopt.transcription.compilation import compile_points
from trajopt.transcription.guess import perturbed
from trajopt.transcription.stage_functions import PointFunction
from trajopt.transcription.transcription import Transcription
from trajopt.transcription.violations import row_violations
from trajopt_library import robots

# The same solver on the same functions, at a tolerance of 1e-9.
SAME_OPTIMUM = 1e-6


Unknowns = Callable[[], np.ndarray]


def go_on(_: dict, __: Unknowns) -> bool:
    return True


def prepared(threads: int = 1) -> PreparedProblem:
    return prepare(hop(), transcription="legendre:2", intervals=7, threads=threads)


def evaluations(made: PreparedProblem) -> list[np.ndarray]:
    generator, nlp = np.random.default_rng(0), made.nlp.engine
    x = made.guess + generator.uniform(-0.2, 0.2, made.guess.shape)
    multipliers = generator.uniform(-1, 1, made.transcription.n_rows)
    return [
        np.array([nlp.f(x)]),
        nlp.g(x),
        nlp.gradient(x),
        nlp.jacobian(x),
        nlp.hessian(x, 0.5, multipliers),
    ]


@pytest.mark.long
def test_two_threads_give_the_numbers_of_one_to_the_last_bit():
    for one, two in zip(evaluations(prepared()), evaluations(prepared(threads=2)), strict=True):
        assert_array_equal(one, two)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_callback_that_says_stop_returns_the_iterate_of_that_moment(solver):
    made, seen = prepared(), []

    def stop_at_three(info: dict, _: Unknowns) -> bool:
        seen.append(info)
        return info["iteration"] < 3

    result = run_solver(made.nlp, made.guess, solver, StoppingCriteria(), {}, stop_at_three)
    assert result.status is Status.INTERRUPTED
    assert result.iterations == seen[-1]["iteration"] == 3
    assert np.max(np.abs(result.x - made.guess)) > 0
    assert made.nlp.engine.f(result.x) == pytest.approx(seen[-1]["objective"])


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_exception_in_a_callback_reaches_the_caller(solver):
    made = prepared()

    def fail(info: dict, _: Unknowns) -> bool:
        raise ZeroDivisionError(f"at iteration {info['iteration']}")

    with pytest.raises(ZeroDivisionError, match="at iteration 0"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), {}, fail)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("option", [{"no_such_option": 1}, {"max_iter": "many"}])
def test_unknown_option_or_value_is_refused_by_name(solver, option):
    made = prepared()
    with refused(f"{solver}.*'{next(iter(option))}'"):
        run_solver(made.nlp, made.guess, solver, StoppingCriteria(), option, go_on)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_iteration_limit_is_a_status(solver):
    made = prepared()
    result = run_solver(made.nlp, made.guess, solver, StoppingCriteria(max_iterations=2), {}, go_on)
    assert result.status is Status.ITERATION_LIMIT
    assert result.iterations <= 3


def symbolic(t: Transcription) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Unknowns, objective and rows of a transcription as one CasADi expression, from its groups."""
    x = ca.MX.sym("x", t.layout.n_unknowns)
    cost, rows = ca.MX(0), ca.mtimes(ca.sparsify(ca.DM(t.linear.toarray())), x)
    for group in t.groups:
        for i, stage in enumerate(group.stages):
            offset = int(t.layout.node_offset[stage])
            z = ca.mtimes(
                ca.sparsify(ca.DM(group.gather.toarray())), x[offset : offset + group.gather.shape[1]]
            )
            o = z
            for layer in group.point.layers:
                o = layer(o)
            value, phi = group.point.terms(z, o if group.point.layers else ca.MX(0, 1), group.parameters[i])
            cost += group.cost_weight[i] * value
            if len(group.row_scale):
                place = ca.DM.zeros(t.n_rows, len(group.row_scale))
                for j, row in enumerate(group.rows[i]):
                    place[int(row), j] = group.row_scale[j]
                rows += ca.mtimes(ca.sparsify(place), phi)
    return x, cost, rows


def swing_up() -> Problem:
    """The arm against gravity."""
    return reach(gravity=True, terms=(terms.TorqueCost(weight=1.0),))


@pytest.mark.long
@pytest.mark.parametrize("build", [swing_up, lean])
def test_optimum_is_that_of_casadi_on_the_same_functions(build):
    made = prepare(build(), transcription="legendre:2", intervals=4)
    t = made.transcription
    x, f, g = symbolic(t)
    options = {"print_time": False, "ipopt": {**IPOPT_OPTIONS, "tol": 1e-9}}
    reference = ca.nlpsol("reference", "ipopt", {"x": x, "f": f, "g": g}, options)
    bounds = {"lbx": t.lower_x, "ubx": t.upper_x, "lbg": t.lower_g, "ubg": t.upper_g}
    expected = reference(x0=made.guess, **bounds)
    assert reference.stats()["success"]
    result = run_solver(made.nlp, made.guess, "ipopt", StoppingCriteria(tolerance=1e-9), {}, go_on)
    assert result.status is Status.SOLVED
    assert result.objective == pytest.approx(float(expected["f"]), rel=SAME_OPTIMUM)


SMALL = 1.0


def test_rows_that_stay_violated_under_growing_multipliers_are_no_progress():
    n = START + 1
    assert is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * TAIL)


def test_multipliers_must_be_large_in_all_of_the_last_iterations():
    n = START + 1
    assert not is_stalled([1.0] * n, [SMALL] * (n - TAIL) + [2 * DUAL_LIMIT] * (TAIL - 1) + [SMALL])


def test_few_iterations_give_no_verdict():
    assert not is_stalled([1.0] * START, [2 * DUAL_LIMIT] * START)
    assert not is_stalled([], [])


def test_rows_that_hold_are_feasible_whatever_the_multipliers():
    assert not is_stalled([1.0] * 30 + [VIOLATION], [2 * DUAL_LIMIT] * 31)


@pytest.mark.parametrize(("after", "stalled"), [(0.9 * DECREASE, False), (1.1 * DECREASE, True)])
def test_the_best_violation_must_fall_by_a_factor(after, stalled):
    slowly = [1.0] + [after] * WINDOW
    assert is_stalled(slowly, [SMALL] * len(slowly)) is stalled


def test_an_increase_after_a_better_iterate_does_not_count_as_a_fall():
    rising = [0.1] + [1.0] * WINDOW
    assert is_stalled(rising, [SMALL] * len(rising))


LIMITS = {"max_iterations": 200, "max_time": 60.0}
# Least torque for the reach: full torque one way, then the other.
LEAST_TORQUE = 4 * inertia() * REACH / REACH_TIME**2
# What the barrier of the elastic problem leaves of each row.
BARRIER = 1e-3


def test_feasible_point_is_found_from_a_start_far_away():
    prepared = prepare(hop())
    start = perturbed(prepared.transcription, prepared.guess, 1, 0.3)
    assert row_violations(prepared.nlp, start).max() > CLEAR_VIOLATION
    found = least_violation(prepared.nlp, start, go_on, **LIMITS)
    assert found.feasible
    assert not found.infeasible
    assert row_violations(prepared.nlp, found.x).max() <= REMOVABLE_VIOLATION


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_torque_below_the_least_is_certified_and_a_larger_one_is_not(share):
    prepared = prepare(limited_reach(share * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    assert found.infeasible
    assert not found.feasible
    enough = prepare(limited_reach(1.5 * LEAST_TORQUE))
    assert least_violation(enough.nlp, enough.guess, go_on, **LIMITS).feasible


def test_rows_give_way_by_what_they_lack_and_prices_bound_the_multipliers():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    found = least_violation(prepared.nlp, prepared.guess, go_on, **LIMITS)
    missed = row_violations(prepared.nlp, found.x)[: prepared.transcription.n_rows]
    assert np.all(missed <= found.gives + BARRIER)
    rows = found.weights[: len(missed)]
    assert np.abs(rows).max() <= 1 + BARRIER
    assert np.abs(rows).max() == pytest.approx(1, abs=BARRIER)


def test_limits_and_the_callback_stop_it_without_a_verdict():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    short = least_violation(prepared.nlp, prepared.guess, go_on, max_iterations=3, max_time=60.0)
    assert short.iterations <= 3
    assert not short.stopped
    stopped = least_violation(
        prepared.nlp, prepared.guess, lambda figures, _: figures["iteration"] < 2, **LIMITS
    )
    assert stopped.stopped
    for found in (short, stopped):
        assert not found.infeasible
        assert not found.feasible


def test_variables_that_a_callback_reads_are_those_of_the_problem():
    prepared = prepare(limited_reach(0.5 * LEAST_TORQUE))
    sizes = set()

    def look(_, read):
        sizes.add(len(read()))
        return True

    least_violation(prepared.nlp, prepared.guess, look, **LIMITS)
    assert sizes == {len(prepared.guess)}


# Central differences with this step: truncation and rounding both about its square root's square, 1e-10
# of slopes up to a few hundred.
STEP = 1e-5
DIFFERENCES = {"rtol": 1e-6, "atol": 1e-6}
# Two graphs of one function in double precision.
SAME = {"rtol": 1e-10, "atol": 1e-10}
# Rounding of a sum of outer products, as a part of the largest eigenvalue.
ROUNDING = 1e-13
# Solves to a tolerance of 1e-6 of problems whose costs are of order one.
HESSIAN_OPTIMUM = 1e-5


def turning(robot: Robot) -> Callable[[float], np.ndarray]:
    """A reference motion that turns the base, away from the robot's own posture."""
    q = robot.reference.copy()
    q[3:7] = [0.0, 0.0, np.sin(0.4), np.cos(0.4)]
    return lambda t: q


def drives(robot: Robot) -> Robot:
    """The robot with windings that heat."""
    drive = Drive.from_motor(gear_ratio=9.0, voltage=48.0, resistance=0.5, torque_constant=0.08)
    return robot.with_drives((drive,) * robot.nu)


def cases() -> dict[str, tuple[Robot, tuple[str, ...], tuple]]:
    ordinary = (
        terms.TorqueCost(weight=0.7), terms.AccelerationCost(weight=0.3), terms.VelocityCost(weight=0.2),
        terms.PostureCost(weight=0.5), terms.WrenchCost(weight=0.4), terms.TorqueLimits(),
    )  # fmt: skip
    feet = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    hot = drives(one_joint_arm(gravity=True))
    return {
        "solo12": (robots.load("solo12"), feet, ordinary),
        "hopper-tracks": (
            hopper(),
            ("foot",),
            (terms.TrackingCost(weight=2.0, reference=turning(hopper())),),
        ),
        "hopper-power": (hopper(), ("foot",), (terms.PowerCost(weight=1.5), terms.TorqueCost(weight=0.1))),
        "planar-recovers": (planar_hopper(), ("foot",), (terms.PowerCost(weight=1.5, recovered=0.4),)),
        "arm-heats": (hot, (), (terms.PowerCost(weight=2.0),)),
    }


def residuals(point: PointFunction, p: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Residuals and weights at z, through the layers one by one, with no derivative."""

    def at(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        o = ca.DM(z)
        for layer in point.layers:
            o = layer(o)
        r, w = point.squares(z, o if point.layers else ca.DM(0, 1), p)
        return np.array(r).ravel(), np.array(w).ravel()

    return at


def slopes(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    steps = STEP * np.eye(len(z))
    return np.column_stack([(function(z + s) - function(z - s)) / (2 * STEP) for s in steps])


def symmetric(lower: object) -> np.ndarray:
    dense = np.array(ca.DM(lower))
    return dense + np.tril(dense, -1).T


@pytest.mark.parametrize("name", cases())
def test_gauss_newton_is_twice_the_weighted_square_of_slopes_by_finite_differences(name):
    robot, contacts, all_terms = cases()[name]
    point, p = point_of(robot, contacts, all_terms)
    made, at = Derivatives(point).gauss_newton, residuals(point, p)
    for seed in range(2):
        generator = np.random.default_rng(seed)
        z = random_point(robot, point, generator)
        slope = slopes(lambda z: at(z)[0], z)
        expected = 2 * 1.3 * slope.T @ (at(z)[1][:, None] * slope)
        scale = max(1.0, float(np.abs(expected).max()))
        found = symmetric(made(z, p, 1.3, generator.uniform(-1, 1, point.n_rows)))
        assert_allclose(found / scale, expected / scale, **DIFFERENCES)


@pytest.mark.parametrize("name", ["solo12", "hopper-tracks"])
def test_costs_of_squares_are_their_weighted_squares(name):
    robot, contacts, all_terms = cases()[name]
    point, p = point_of(robot, contacts, all_terms)
    z = random_point(robot, point, np.random.default_rng(3))
    r, w = residuals(point, p)(z)
    assert_allclose(float(Derivatives(point).value(z, p)[0]), w @ r**2, **SAME)


@pytest.mark.parametrize(("recovered", "smoothing"), [(-1.0, 0.1), (0.4, 0.05)])
def test_curvature_of_power_is_that_of_its_rounded_magnitude(recovered, smoothing):
    """Along the power itself: the second difference of the cost as a function of the power alone."""
    robot = planar_hopper()
    point, p = point_of(
        robot, ("foot",), (terms.PowerCost(weight=1.5, recovered=recovered, smoothing=smoothing),)
    )
    power, weights = residuals(point, p)(random_point(robot, point, np.random.default_rng(1)))

    def cost(x: np.ndarray) -> np.ndarray:
        return 1.5 * (1 - recovered) / 2 * np.sqrt(x**2 + smoothing**2)

    step = 1e-4
    curvature = (cost(power + step) - 2 * cost(power) + cost(power - step)) / step**2
    assert_allclose(2 * weights, curvature, rtol=1e-4, atol=1e-6)


def dense_hessian(prepared: PreparedProblem, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
    nlp, n = prepared.nlp, len(x)
    values = nlp.engine.hessian(x, 1.0, multipliers)
    lower = sparse.csr_matrix((values, (nlp.hessian_row, nlp.hessian_column)), shape=(n, n)).toarray()
    return lower + np.tril(lower, -1).T


def problems_with_every_cost() -> dict[str, Problem]:
    free = hop()
    phases = tuple(
        replace(phase, duration_bounds=(0.5 * phase.duration, 2 * phase.duration))
        for phase in free.schedule.phases
    )
    timed = replace(free, schedule=replace(free.schedule, phases=phases))
    more = (
        terms.TimeCost(weight=0.5),
        terms.PowerCost(weight=0.5),
        terms.TrackingCost(weight=1.0, reference=turning(hopper())),
    )
    return {"hop": free, "free-durations": replace(timed, terms=(*timed.terms, *more)), "reach": reach()}


@pytest.mark.parametrize("name", problems_with_every_cost())
def test_gauss_newton_is_nowhere_negative_and_knows_no_multipliers(name):
    prepared = prepare(problems_with_every_cost()[name], intervals=6, hessian="gauss-newton")
    t = prepared.transcription
    for seed in range(2):
        x = perturbed(t, prepared.guess, seed, 0.5)
        multipliers = np.random.default_rng(seed).normal(size=t.n_rows)
        found = dense_hessian(prepared, x, multipliers)
        assert_allclose(found, dense_hessian(prepared, x, 0 * multipliers), rtol=0, atol=0)
        values = np.linalg.eigvalsh(found)
        assert values[-1] > 0
        assert values[0] >= -ROUNDING * len(values) * values[-1]


def test_where_residuals_and_rows_are_linear_gauss_newton_is_exact():
    options = {"intervals": 4}
    approximate, exact = (prepare(reach(), hessian=h, **options) for h in ("gauss-newton", "exact"))
    x, zero = exact.guess, np.zeros(exact.transcription.n_rows)
    assert_allclose(dense_hessian(approximate, x, zero), dense_hessian(exact, x, zero), **SAME)


def test_costs_without_squares_have_no_curvature():
    prepared = prepare(reach(terms=(terms.TimeCost(weight=1.0),)), intervals=3, hessian="gauss-newton")
    found = prepared.nlp.engine.hessian(prepared.guess, 1.0, np.ones(prepared.transcription.n_rows))
    assert_allclose(found, 0.0)


@pytest.mark.parametrize("hessian", ["gauss-newton", "limited-memory"])
def test_every_hessian_ends_at_the_optimum_of_the_exact_one(hessian):
    problem = reach(gravity=True, terms=(terms.TorqueCost(weight=1.0), terms.VelocityCost(weight=0.1)))
    best = solve(problem).statistics.objective
    found = solve(problem, hessian=hessian)
    assert found.converged
    assert found.statistics.hessian == hessian
    assert found.statistics.objective == pytest.approx(best, rel=HESSIAN_OPTIMUM)


def test_exact_is_the_default():
    assert solve(reach()).statistics.hessian == "exact"


def test_a_solver_that_makes_up_no_hessian_says_so(monkeypatch):
    monkeypatch.setitem(SOLVERS, "own", replace(SOLVERS["ipopt"], hessians=("exact", "gauss-newton")))
    with refused("own does not take the Hessian 'limited-memory'; allowed: exact, gauss-newton"):
        solve(reach(), solver="own", hessian="limited-memory")
    prepared = prepare(reach(), hessian="limited-memory")
    with refused("does not take"):
        solve_prepared(prepared, prepared.guess, origin={"seed": 0, "perturb": 0.0}, solver="own")


@pytest.mark.parametrize("call", [prepare, solve])
def test_unknown_hessian_is_refused(call):
    with refused("unknown Hessian 'newton'; allowed: exact, gauss-newton, limited-memory"):
        call(reach(), hessian="newton")


def test_command_line_refuses_an_unknown_hessian_in_one_line():
    found = invoke("solve", "ur5-reach", "--hessian", "newton")
    assert found.exit_code == 2
    assert found.stderr.strip().splitlines() == [
        "trajopt: unknown Hessian 'newton'; allowed: exact, gauss-newton, limited-memory"
    ]


def files(folder: Path) -> list[str]:
    return sorted(file.suffix[1:] for file in folder.iterdir())


def test_nothing_is_built_that_is_not_asked_for_nor_twice(tmp_path, monkeypatch):
    points = [prepare(reach()).transcription.groups[0].point]
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    compile_points(points, "limited-memory")
    assert files(tmp_path) == ["first", "value"]
    compile_points(points, "gauss-newton")
    assert files(tmp_path) == ["first", "gauss_newton", "value"]
    compile_points(points)
    assert files(tmp_path) == ["first", "gauss_newton", "second", "value"]
    assert compile_points(points, "gauss-newton")[1].built == 0
    assert compile_points(points, "limited-memory")[1].built == 0
