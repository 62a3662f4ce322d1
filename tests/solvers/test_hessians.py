"""Hessians to choose from: Gauss-Newton against finite differences, no second order for limited memory."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from tests.support.command_lines import invoke
from tests.support.problems import hop, hopper, one_joint_arm, planar_hopper, point_of, random_point, reach
from trajopt.cache import CACHE_VARIABLE
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.robot import Robot
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.solving import PreparedProblem, prepare, solve, solve_prepared
from trajopt.terms import (
    AccelerationCost,
    PostureCost,
    PowerCost,
    TimeCost,
    TorqueCost,
    TorqueLimits,
    TrackingCost,
    VelocityCost,
    WrenchCost,
)
from trajopt.transcription.compilation import compile_points
from trajopt.transcription.guess import perturbed
from trajopt.transcription.stage_functions import Derivatives, PointFunction
from trajopt_library import robots

# Central differences with this step: truncation and rounding both about its square root's square, 1e-10
# of slopes up to a few hundred.
STEP = 1e-5
DIFFERENCES = {"rtol": 1e-6, "atol": 1e-6}
# Two graphs of one function in double precision.
SAME = {"rtol": 1e-10, "atol": 1e-10}
# Rounding of a sum of outer products, as a part of the largest eigenvalue.
ROUNDING = 1e-13
# Solves to a tolerance of 1e-6 of problems whose costs are of order one.
SAME_OPTIMUM = 1e-5


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
        TorqueCost(weight=0.7), AccelerationCost(weight=0.3), VelocityCost(weight=0.2),
        PostureCost(weight=0.5), WrenchCost(weight=0.4), TorqueLimits(),
    )  # fmt: skip
    feet = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    hot = drives(one_joint_arm(gravity=True))
    return {
        "solo12": (robots.load("solo12"), feet, ordinary),
        "hopper-tracks": (hopper(), ("foot",), (TrackingCost(weight=2.0, reference=turning(hopper())),)),
        "hopper-power": (hopper(), ("foot",), (PowerCost(weight=1.5), TorqueCost(weight=0.1))),
        "planar-recovers": (planar_hopper(), ("foot",), (PowerCost(weight=1.5, recovered=0.4),)),
        "arm-heats": (hot, (), (PowerCost(weight=2.0),)),
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
    robot, contacts, terms = cases()[name]
    point, p = point_of(robot, contacts, terms)
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
    robot, contacts, terms = cases()[name]
    point, p = point_of(robot, contacts, terms)
    z = random_point(robot, point, np.random.default_rng(3))
    r, w = residuals(point, p)(z)
    assert_allclose(float(Derivatives(point).value(z, p)[0]), w @ r**2, **SAME)


@pytest.mark.parametrize(("recovered", "smoothing"), [(-1.0, 0.1), (0.4, 0.05)])
def test_curvature_of_power_is_that_of_its_rounded_magnitude(recovered, smoothing):
    """Along the power itself: the second difference of the cost as a function of the power alone."""
    robot = planar_hopper()
    point, p = point_of(robot, ("foot",), (PowerCost(weight=1.5, recovered=recovered, smoothing=smoothing),))
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
        TimeCost(weight=0.5),
        PowerCost(weight=0.5),
        TrackingCost(weight=1.0, reference=turning(hopper())),
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
    prepared = prepare(reach(terms=(TimeCost(weight=1.0),)), intervals=3, hessian="gauss-newton")
    found = prepared.nlp.engine.hessian(prepared.guess, 1.0, np.ones(prepared.transcription.n_rows))
    assert_allclose(found, 0.0)


@pytest.mark.parametrize("hessian", ["gauss-newton", "limited-memory"])
def test_every_hessian_ends_at_the_optimum_of_the_exact_one(hessian):
    problem = reach(gravity=True, terms=(TorqueCost(weight=1.0), VelocityCost(weight=0.1)))
    best = solve(problem).statistics.objective
    found = solve(problem, hessian=hessian)
    assert found.converged
    assert found.statistics.hessian == hessian
    assert found.statistics.objective == pytest.approx(best, rel=SAME_OPTIMUM)


def test_exact_is_the_default():
    assert solve(reach()).statistics.hessian == "exact"


def test_a_solver_that_makes_up_no_hessian_says_so(monkeypatch):
    monkeypatch.setitem(SOLVERS, "own", replace(SOLVERS["ipopt"], hessians=("exact", "gauss-newton")))
    with pytest.raises(
        InputError, match="own does not take the Hessian 'limited-memory'; allowed: exact, gauss-newton"
    ):
        solve(reach(), solver="own", hessian="limited-memory")
    prepared = prepare(reach(), hessian="limited-memory")
    with pytest.raises(InputError, match="does not take"):
        solve_prepared(prepared, prepared.guess, origin={"seed": 0, "perturb": 0.0}, solver="own")


@pytest.mark.parametrize("call", [prepare, solve])
def test_unknown_hessian_is_refused(call):
    with pytest.raises(
        InputError, match="unknown Hessian 'newton'; allowed: exact, gauss-newton, limited-memory"
    ):
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
