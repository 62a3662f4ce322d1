"""Schemes and meshes of them: points, weights, interpolants, unequal intervals, order at the nodes."""

import statistics
from math import factorial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.problems import SCHEME_ORDERS, hop, hopper, lean, one_phase
from tests.support.refusals import refusals, refused
from tests.support.tumbling import DURATION, Interval, errors_at_the_end, slope, start, torque
from trajopt import (
    Moment,
    Phase,
    Problem,
    Solution,
    check,
    end_of,
    middle_of,
    start_of,
)
from trajopt.motion import energy
from trajopt.motion.grid import interpolated, mesh_of
from trajopt.schedule import END
from trajopt.solvers.drivers import run_solver
from trajopt.solvers.result import StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.extraction import extract
from trajopt.solving.solving import PreparedProblem, prepare, solve
from trajopt.terms import NodePlace
from trajopt.terms.interfaces import nodes_of
from trajopt.transcription import transcribe
from trajopt.transcription.guess import perturbed
from trajopt.transcription.mesh import Mesh, PhaseMesh, equal_fractions
from trajopt.transcription.schemes import FAMILIES, scheme
from trajopt_library import problems

# Step of central differences, and what their truncation and rounding leave of entries of order one.
STEP, DIFFERENCES = 1e-6, 1e-6
# The solver's tolerance grows by what follows a point within its interval.
CONSISTENT = 1e-5
# Of sums of products.
ROUNDING = 1e-12

UNEVEN = Mesh(
    phases=(
        PhaseMesh(scheme="legendre:2", widths=(0.25, 0.25, 0.125, 0.125, 0.25)),
        PhaseMesh(scheme="legendre:3", widths=(0.3, 0.7)),
        PhaseMesh(scheme="radau:2", widths=(0.1, 0.1, 0.2, 0.3, 0.3)),
    )
)


@pytest.fixture(scope="module")
def uneven():
    return solve(hop(), mesh=UNEVEN)


@pytest.mark.long
def test_intervals_have_the_widths_and_the_points_of_their_phase(uneven):
    assert uneven.converged
    durations = [phase.duration for phase in hop().schedule.phases]
    steps = np.concatenate([T * np.array(m.widths) for T, m in zip(durations, UNEVEN.phases, strict=True)])
    assert_allclose(np.diff(uneven.interval_t, axis=1)[:, 0], steps, rtol=1e-12)
    methods = [phase.method for phase in UNEVEN.phases for _ in phase.widths]
    for method, rows, (begin, end) in zip(methods, uneven.intervals, uneven.interval_t, strict=True):
        points = [row for row in rows if uneven.collocation[row]]
        assert_allclose((uneven.t[points] - begin) / (end - begin), method.c, atol=1e-12)


def test_uneven_mesh_holds_the_dynamics_and_joins_its_intervals(uneven):
    found = check(uneven).to_dict()
    for name in ("base_residual", "actuated_residual", "contact_acceleration", "state_jump"):
        assert found[name] < CONSISTENT, name


def test_file_tells_its_mesh(uneven, tmp_path):
    assert mesh_of(Solution.load(uneven.save(tmp_path / "hop.npz"))) == UNEVEN
    assert uneven.statistics.transcription == "legendre:2,legendre:3,radau:2"


def test_mesh_of_a_file_without_one_follows_from_its_times():
    even = solve(hop(), transcription="legendre:2", intervals=12, max_iterations=0)
    old = even.with_statistics(mesh=None)
    assert mesh_of(old) == mesh_of(even) == Mesh.uniform("legendre:2", hop().schedule.intervals(12))


def test_derivatives_on_an_uneven_mesh_are_those_of_differences():
    prepared = prepare(hop(), mesh=UNEVEN)
    engine, x = prepared.nlp.engine, prepared.guess
    direction = np.random.default_rng(0).normal(size=x.size)
    ahead, behind = (np.array(engine.g(x + sign * STEP * direction)) for sign in (1, -1))
    product = np.zeros(prepared.transcription.n_rows)
    np.add.at(product, prepared.nlp.row, np.array(engine.jacobian(x)) * direction[prepared.nlp.column])
    scale = np.abs(product).max()
    assert_allclose(product / scale, (ahead - behind) / (2 * STEP) / scale, atol=DIFFERENCES)


def test_mesh_of_equal_widths_is_the_uniform_transcription():
    mesh = Mesh.uniform("legendre:2", hop().schedule.intervals(10))
    given, plain = transcribe(hop(), mesh=mesh), transcribe(hop(), "legendre:2", 10)
    assert_array_equal(given.linear.toarray(), plain.linear.toarray())
    assert len(given.groups) == len(plain.groups)
    assert_allclose(given.layout.node_times, plain.layout.node_times)


@pytest.mark.long
def test_solution_on_a_split_mesh_starts_where_the_coarse_one_ends(uneven):
    split = Mesh(phases=tuple(phase.split([2] * phase.count) for phase in UNEVEN.phases))
    cold = solve(hop(), mesh=split)
    warm = solve(hop(), mesh=split, start=uneven)
    assert warm.converged
    assert warm.statistics.iterations < cold.statistics.iterations
    assert warm.statistics.objective == pytest.approx(cold.statistics.objective, rel=1e-4)


def test_multipliers_of_an_uneven_mesh_return_to_their_own_mesh(uneven):
    again = solve(hop(), mesh=UNEVEN, start=uneven)
    assert again.converged
    assert again.statistics.iterations <= 2


def test_one_scheme_for_each_phase_is_named_with_commas():
    names = "legendre:1,radau:3,trapezoidal"
    mesh = transcribe(hop(), names, 9).layout.mesh
    assert [phase.scheme for phase in mesh.phases] == names.split(",")
    assert mesh.transcription == names


def test_velocity_source_takes_an_uneven_mesh():
    mesh = Mesh(phases=(PhaseMesh(scheme="radau:2", widths=(0.2, 0.3, 0.5)),) * len(lean().schedule.phases))
    found = solve(lean(), mesh=mesh)
    assert found.converged
    assert found.n_intervals == 3 * len(lean().schedule.phases)


def test_node_nearest_to_a_fraction_goes_by_time():
    phase = Phase(name="flight", duration=0.2)
    place = NodePlace(phase, 0, (0.0, 0.1, 0.2, 0.45, 1.0), last=False)
    assert place.nearest(0.5) == 3
    assert NodePlace(phase, 0, equal_fractions(5), last=False).nearest(0.5) == 2
    assert NodePlace(phase, 0, equal_fractions(4), last=False).nearest(1.0) == 4


def test_the_end_of_a_phase_is_the_start_of_the_next_one():
    before, phase = Phase(name="stance", duration=0.3), Phase(name="flight", duration=0.2)
    end = NodePlace(before, 4, equal_fractions(4), last=False)
    shared = NodePlace(phase, 0, equal_fractions(5), last=False, before=end)
    alone = NodePlace(phase, 0, equal_fractions(5), last=False)  # after an impact
    assert [shared.is_at(moment) for moment in (end_of("stance"), start_of("flight"))] == [True, True]
    assert [alone.is_at(moment) for moment in (end_of("stance"), start_of("flight"))] == [False, True]
    assert end.is_at(end_of("stance"))
    assert end.is_at(Moment("stance", 0.9))
    assert not end.is_at(END)
    assert not shared.is_at(middle_of("flight"))


@pytest.mark.parametrize(("impact", "counts"), [(False, [4, 5]), (True, [5, 5])])
def test_the_last_node_of_a_phase_is_its_own_before_an_impact_and_at_the_end(impact, counts):
    phases = Phase(name="flight", duration=0.2), Phase(name="stance", duration=0.3, impact=impact)
    nodes = [list(nodes_of(phases, index, equal_fractions(4))) for index in range(2)]
    assert [len(own) for own in nodes] == counts
    assert [place.last for own in nodes for place in own] == [False] * (sum(counts) - 1) + [True]
    assert sum(place.is_at(end_of("flight")) for own in nodes for place in own) == 1


def test_step_at_a_node_is_the_wider_of_its_intervals():
    phase, fractions = Phase(name="flight", duration=0.2), (0.0, 0.1, 0.4, 1.0)
    steps = [NodePlace(phase, index, fractions, last=False).step for index in range(4)]
    assert_allclose(steps, [0.1, 0.3, 0.6, 0.6])


test_phase_meshes_that_are_none_are_refused = refusals(
    lambda widths, scheme: PhaseMesh(scheme=scheme, widths=widths),
    ((), "legendre:2", r"widths of a phase's intervals are \(\); allowed: positive, 1 in sum"),
    ((0.5, 0.6), "legendre:2", "1 in sum"),
    ((1.5, -0.5), "legendre:2", "> 0"),
    ((float("nan"), 1.0), "legendre:2", "> 0"),
    ((1.0,), "euler", "unknown transcription 'euler'"),
)


def test_meshes_that_do_not_fit_are_refused():
    one = Mesh.uniform("legendre:2", [4])
    with refused("mesh has 1 phases, problem 'hop' 3"):
        transcribe(hop(), mesh=one)
    with refused("mesh is given with a transcription or intervals"):
        solve(hop(), mesh=UNEVEN, intervals=12)
    with refused("names 2 schemes for 3 phases"):
        transcribe(hop(), "legendre:2,legendre:3", 12)


def test_energy_and_shared_wrenches_take_every_phases_own_scheme(uneven):
    torque, rates = uneven.tau, uneven.v[:, uneven.n_unactuated :]
    expected, methods = 0.0, [phase.method for phase in UNEVEN.phases for _ in phase.widths]
    for method, rows, (begin, end) in zip(methods, uneven.intervals, uneven.interval_t, strict=True):
        points = [row for row in rows if uneven.collocation[row]]
        expected += (end - begin) * method.b1 @ np.abs(torque[points] * rates[points]).sum(axis=1)
    # Energy given back counts as drawn when as much of it is lost as of what is drawn.
    assert energy(uneven, recovered=-1.0) == pytest.approx(expected)
    assert_allclose(interpolated(uneven, uneven.f), uneven.f, atol=ROUNDING * np.abs(uneven.f).max())


# Integrals of Lagrange polynomials of degree up to 4 on [0, 1]: tens of roundings.
INTEGRALS = 1e-13
# A quadrature that is not exact misses a monomial of low degree by far more than this.
INEXACT = 1e-6
# What a scheme misses is a difference of numbers near 1/8, down to 2e-5: so many roundings of it.
CONSTANT = 1e-9
COLLOCATION = [
    f"{name}:{degree}" for name, family in FAMILIES.items() for degree in range(1, family.degrees + 1)
]
UNKNOWN = (
    "legendre", "legendre:0", "legendre:5", "radau:-1", "radau:2x", "radau:²", "radau:02", "euler", "",
    "trapezoidal:", "trapezoidal:1",
)  # fmt: skip
CLASSIC = tuple(name for name, family in FAMILIES.items() if not family.degrees)


def exact_degree(name: str) -> int:
    method = scheme(name)
    return 2 * method.s - 1 if name.startswith("legendre") else 2 * method.s - 2


@pytest.mark.parametrize("name", COLLOCATION)
def test_quadrature_is_exact_to_its_degree_and_no_further(name):
    method = scheme(name)
    errors = [method.b1 @ method.c**n - 1 / (n + 1) for n in range(exact_degree(name) + 2)]
    assert_allclose(errors[:-1], 0.0, atol=INTEGRALS)
    assert abs(errors[-1]) > INEXACT


@pytest.mark.parametrize("name", COLLOCATION)
def test_double_quadrature_is_exact_one_degree_less(name):
    method = scheme(name)
    for n in range(exact_degree(name)):
        assert_allclose(method.b2 @ method.c**n, 1 / ((n + 1) * (n + 2)), atol=INTEGRALS)


@pytest.mark.parametrize("name", COLLOCATION)
def test_collocation_matrices_integrate_polynomials_through_the_points_exactly(name):
    method = scheme(name)
    polynomial = Polynomial(np.random.default_rng(0).uniform(-1, 1, method.s))
    y = polynomial(method.c)
    assert_allclose(method.A1 @ y, polynomial.integ(1)(method.c), atol=INTEGRALS)
    assert_allclose(method.A2 @ y, polynomial.integ(2)(method.c), atol=INTEGRALS)
    assert_allclose(
        [method.b1 @ y, method.b2 @ y], [polynomial.integ(1)(1), polynomial.integ(2)(1)], atol=INTEGRALS
    )


@pytest.mark.parametrize("name", COLLOCATION)
def test_collocation_points_lie_in_the_interval_and_radau_ends_it(name):
    method = scheme(name)
    assert np.all(np.diff(method.c) > 0)
    assert method.c[0] > 0
    assert method.c[-1] == pytest.approx(1.0, abs=INTEGRALS) if name.startswith("radau") else method.c[-1] < 1
    assert method.order == exact_degree(name) + 1


def test_trapezoidal_is_lobatto_3a_of_two_points():
    method = scheme("trapezoidal")
    half = np.array([[0, 0], [0.5, 0.5]])
    assert_allclose(method.A1, half, atol=INTEGRALS)
    assert_allclose(method.A2, half @ half, atol=INTEGRALS)
    assert_allclose([method.c, method.b1, method.b2], [[0, 1], [0.5, 0.5], [0.25, 0.25]], atol=INTEGRALS)


def test_hermite_simpson_is_lobatto_3a_of_three_points():
    method = scheme("hermite-simpson")
    tableau = np.array([[0, 0, 0], [5, 8, -1], [4, 16, 4]]) / 24
    assert_allclose(method.A1, tableau, atol=INTEGRALS)
    assert_allclose(method.A2, tableau @ tableau, atol=INTEGRALS)
    assert_allclose([method.c, method.b1], [[0, 0.5, 1], np.array([1, 4, 1]) / 6], atol=INTEGRALS)
    assert_allclose(method.b2, method.b1 @ tableau, atol=INTEGRALS)


def test_semi_implicit_euler_moves_with_the_velocity_of_the_end():
    method = scheme("semi-implicit-euler")
    assert_allclose([method.A1[0, 0], method.A2[0, 0], method.c[0]], 0.0)
    assert_allclose([method.b1[0], method.b2[0]], 1.0)  # x + h v + h^2 y = x + h (v + h y)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_rates_of_samples_are_exact_for_polynomials_through_them(name):
    found = scheme(name)
    fractions, matrix = found.differentiation
    assert set(found.c) <= set(fractions)
    for power in range(len(fractions)):
        exact = power * found.c ** max(power - 1, 0)
        assert_allclose(matrix @ fractions**power, exact, atol=1e-12)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_interpolation_is_the_identity_at_the_points(name):
    method = scheme(name)
    assert_allclose(method.interpolation(method.c), np.eye(method.s), atol=INTEGRALS)
    assert_allclose(method.interpolation(np.linspace(0, 1, 7)).sum(axis=1), 1.0, atol=INTEGRALS)


@pytest.mark.parametrize("name", [*COLLOCATION, *CLASSIC])
def test_scheme_knows_its_name_and_cannot_be_changed(name):
    method = scheme(name)
    assert method.name == name
    with pytest.raises(ValueError, match="read-only"):
        method.b1[0] = 0.0


@pytest.mark.parametrize("s", range(1, FAMILIES["legendre"].degrees + 1))
def test_error_constants_are_those_of_the_literature(s):
    gauss = factorial(s) ** 4 / ((2 * s + 1) * factorial(2 * s) ** 3)
    radau = s * factorial(s - 1) ** 4 / (2 * factorial(2 * s - 1) ** 3)
    assert scheme(f"legendre:{s}").error_constant == pytest.approx(gauss, rel=CONSTANT)
    assert scheme(f"radau:{s}").error_constant == pytest.approx(radau, rel=CONSTANT)


def test_the_next_degree_is_asked_of_the_scheme():
    assert scheme("radau:3").finer is scheme("radau:4")
    assert scheme("radau:4").finer is None
    assert scheme("trapezoidal").finer is None


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_scheme_is_refused_with_the_list(name):
    with refused(r"allowed: legendre:1\.\.4.*semi-implicit-euler"):
        scheme(name)


# The measured slope may differ from the order by this much: the next term of the error's expansion.
SLOPE = 0.3
# Numbers of intervals whose errors lie between the asymptotic range and the roundoff floor.
INTERVALS = {
    1: (80, 160, 320),
    2: (20, 40, 80),
    3: (16, 32, 64),
    4: (10, 20, 40),
    5: (10, 20, 40),
    6: (8, 16, 32),
}
ROUNDOFF_FLOOR = 3e-12
# The propagated states solve the NLP's rows up to Newton's tolerance, in scaled units.
DEFECT = 1e-11


@pytest.mark.parametrize(("name", "order"), SCHEME_ORDERS.items())
def test_error_at_the_nodes_falls_with_the_order_of_the_scheme(name, order):
    assert scheme(name).order == order
    counts = INTERVALS[order]
    errors = errors_at_the_end(scheme(name), counts)
    assert errors[-1] > ROUNDOFF_FLOOR
    assert slope(counts, errors) == pytest.approx(order, abs=SLOPE)


def tumbling() -> Problem:
    """The same motion as a problem: one phase without contacts."""
    q, v = start()
    return one_phase(hopper(), duration=DURATION, initial_q=q, initial_v=v, guess=lambda t: q)


@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_transcription_holds_on_the_propagated_states(name):
    count = 8
    prepared = prepare(tumbling(), transcription=name, intervals=count)
    layout = prepared.transcription.layout
    propagation = Interval(scheme(name)).propagate(count)
    x = np.zeros(layout.n_unknowns)
    for k in range(count + 1):
        x[layout.node(k)] = propagation.nodes[k]
    for k in range(count):
        window = x[layout.node_offset[k] : layout.node_offset[k + 1]]
        for i in range(layout.scheme_of(0).s):
            window[layout.local_derivative(0, i)] = propagation.y[k, i]
    x = x / prepared.transcription.scale
    assert set(prepared.transcription.rows.names) == {"defect", "base_dynamics"}
    assert_allclose(prepared.nlp.engine.g(x), 0.0, atol=DEFECT)
    solution = extract(prepared.transcription, x)
    at_points = solution.collocation
    given = np.array([torque(t) for t in solution.t[at_points]])
    assert_allclose(solution.tau[at_points], given, atol=DEFECT * hopper().weight)


COARSE, FINE = 25, 200
MOST = 1.3  # iterations on the fine mesh over those on the coarse one, or the other way round
SEEDS, SIGMA = (1, 2, 3), 0.1
SAME = (
    1e-4  # relative, of the optimum: far above a solver's tolerance, of the order of the coarse mesh's error
)
# A line search tries a step, its second-order corrections and shorter steps; on average few.
EVALUATIONS = 4.0


def prepared(name: str, intervals: int) -> PreparedProblem:
    return prepare(problems.load(name), intervals=intervals)


@pytest.mark.long
@pytest.mark.parametrize("name", ["ur5-reach", "hopper-hop"])
def test_sizes_and_nonzeros_grow_linearly(name: str) -> None:
    found = []
    for intervals in (24, 48, 72):  # so many that phases of 0.4, 0.3 and 0.5 s share them exactly
        nlp = prepared(name, intervals).nlp
        t = nlp.transcription
        found.append([t.layout.n_unknowns, t.n_rows, len(nlp.row), len(nlp.hessian_row), len(t.linear.data)])
    first, second = np.diff(np.array(found), axis=0)
    assert_array_equal(first, second)


def solved(made: PreparedProblem, seed: int) -> tuple[int, float, int]:
    """Iterations, objective, evaluations of values."""
    start = perturbed(made.transcription, made.guess, seed, SIGMA) if seed else made.guess
    result = run_solver(made.nlp, start, "ipopt", StoppingCriteria(), {}, lambda *_: True)
    assert result.status is Status.SOLVED, (seed, result.solver_status)
    return result.iterations, result.objective, made.nlp.engine.timings()["value"][1]


@pytest.mark.long
def test_iterations_do_not_grow_with_the_mesh() -> None:
    coarse, fine = ([solved(prepared("ur5-reach", n), seed) for seed in (0, *SEEDS)] for n in (COARSE, FINE))
    own = [rows[0][0] for rows in (coarse, fine)]
    medians = [statistics.median(row[0] for row in rows[1:]) for rows in (coarse, fine)]
    assert max(own) <= MOST * min(own)
    assert max(medians) <= MOST * min(medians)
    for iterations, _, evaluations in (*coarse, *fine):
        assert evaluations <= EVALUATIONS * (iterations + 1)


@pytest.mark.slow
def test_a_hop_is_solved_on_meshes_from_coarse_to_fine() -> None:
    optima = [solved(prepared("hopper-hop", n), 0)[1] for n in (100, FINE)]
    assert optima[0] == pytest.approx(optima[1], rel=SAME)
