"""The engine and its tapes against CasADi: values, derivatives, and input it refuses."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from tests.support.grouped_nlps import (
    GroupedProblem,
    arguments,
    cart_pole,
    dense,
    dense_jacobian,
    logarithm_well,
)
from tests.support.problems import hop
from tests.support.registers import REGISTERS, registers
from trajopt import _engine
from trajopt.transcription import Derivatives, transcribe
from trajopt.transcription.sparse_maps import DerivativeMap, Pattern, SparseMatrix, hessian_map, jacobian_map

ROUNDING = 1e-12  # sums of the same terms in another order
STEP = 1e-6  # of central differences: error about STEP^2 + 1e-16 / STEP
DIFFERENCES = 1e-7


@pytest.fixture(scope="module")
def problem() -> GroupedProblem:
    return cart_pole()


@pytest.fixture(scope="module")
def nlp(problem):
    return _engine.Nlp(**arguments(problem))


@pytest.fixture
def point(problem):
    return problem.x0 + 0.3 * np.random.default_rng(3).standard_normal(problem.n_x)


def hessian(nlp, problem, x, sigma, lam):
    lower = dense((problem.n_x, problem.n_x), problem.patterns["hessian"], nlp.hessian(x, sigma, lam))
    return lower + np.tril(lower, -1).T


def difference_quotients(function, x):
    steps = STEP * np.eye(len(x))
    return np.stack([(function(x + d) - function(x - d)) / (2 * STEP) for d in steps], axis=-1)


def test_values_and_derivatives_are_those_of_one_expression(nlp, problem, point):
    e = problem.expression()
    lam, sigma = np.random.default_rng(4).standard_normal(problem.n_g), 0.7
    multiplier = ca.SX.sym("lam", problem.n_g)
    second = ca.hessian(sigma * e["f"] + ca.dot(multiplier, e["g"]), e["x"])[0]
    whole = ca.Function(
        "whole", [e["x"], multiplier],
        [e["f"], e["g"], ca.gradient(e["f"], e["x"]), ca.jacobian(e["g"], e["x"]), second],
    )  # fmt: skip
    f, g, gradient, first, second = (np.array(part) for part in whole(point, lam))
    assert_allclose(nlp.f(point), f.item(), rtol=ROUNDING)
    assert_allclose(nlp.g(point), g.ravel(), atol=ROUNDING)
    assert_allclose(nlp.gradient(point), gradient.ravel(), atol=ROUNDING)
    assert_allclose(dense_jacobian(nlp, problem, point), first, atol=ROUNDING)
    assert_allclose(hessian(nlp, problem, point, sigma, lam), second, atol=ROUNDING * 10)


def test_derivatives_are_limits_of_differences(nlp, problem, point):
    lam = np.random.default_rng(5).standard_normal(problem.n_g)
    assert_allclose(nlp.gradient(point), difference_quotients(nlp.f, point), atol=DIFFERENCES)
    assert_allclose(dense_jacobian(nlp, problem, point), difference_quotients(nlp.g, point), atol=DIFFERENCES)

    def slope(x):
        return 0.3 * nlp.gradient(x) + dense_jacobian(nlp, problem, x).T @ lam

    assert_allclose(
        hessian(nlp, problem, point, 0.3, lam), difference_quotients(slope, point), atol=DIFFERENCES
    )


def every_number(nlp, problem, x):
    lam = np.cos(np.arange(problem.n_g))
    return np.concatenate([[nlp.f(x)], nlp.g(x), nlp.gradient(x), nlp.jacobian(x), nlp.hessian(x, 0.9, lam)])


@pytest.mark.parametrize("threads", [2, 7, 64])
def test_threads_change_no_bit(nlp, problem, point, threads):
    parallel = _engine.Nlp(**arguments(problem, threads=threads))
    assert_array_equal(every_number(parallel, problem, point), every_number(nlp, problem, point))


def test_a_point_is_evaluated_once_a_kind(problem, point):
    nlp = _engine.Nlp(**arguments(problem))
    for _ in range(3):
        nlp.f(point), nlp.g(point), nlp.gradient(point), nlp.jacobian(point)
    assert {kind: count for kind, (_, count) in nlp.timings().items()} == {
        "value": 1,
        "first": 1,
        "second": 0,
    }
    nlp.f(point + 1e-3)
    assert nlp.timings()["value"][1] == 2


def changed(arguments, key, change):
    """A copy with one entry, of the NLP or of its first group, changed."""
    copy = {**arguments, "groups": [dict(group) for group in arguments["groups"]]}
    target = copy if key in copy else copy["groups"][0]
    target[key] = change(target[key])
    return copy


def test_groups_with_one_function_share_its_runs_and_change_no_number(problem, point):
    given = arguments(problem)
    half = np.arange(len(given["groups"][0]["x_offset"])) < 7
    by_stage = ("x_offset", "p", "cost_weight", "row", "jac_target", "hess_target")
    swing = given["groups"][0]
    parts = [
        {**swing, **{key: np.ascontiguousarray(swing[key][which]) for key in by_stage}}
        for which in (half, ~half)
    ]
    split = _engine.Nlp(**{**given, "groups": [*parts, given["groups"][1]]})
    assert_allclose(
        every_number(split, problem, point), every_number(_engine.Nlp(**given), problem, point), atol=ROUNDING
    )


def test_a_group_may_have_no_cost(problem, point):
    given = arguments(problem)
    z, p = ca.SX.sym("z", 5), ca.SX.sym("p", 1)
    phi = problem.groups[0].rows(z, p)
    none = ca.SX(1, 1)
    free = changed(given, "value", lambda _: _engine.Tape(ca.Function("value", [z, p], [none, phi])))
    first = ca.Function("first", [z, p], [none, phi, ca.SX(5, 1), ca.jacobian(phi, z)])
    nlp = _engine.Nlp(**changed(free, "first", lambda _: _engine.Tape(first)))
    goal, full = GroupedProblem(**{**vars(problem), "groups": problem.groups[1:]}), _engine.Nlp(**given)
    e = goal.expression()
    cost = ca.Function("cost", [e["x"]], [e["f"], ca.gradient(e["f"], e["x"])])
    assert_allclose(nlp.f(point), float(cost(point)[0]), rtol=ROUNDING)
    assert_allclose(nlp.gradient(point), np.array(cost(point)[1]).ravel(), atol=ROUNDING)
    assert_array_equal(nlp.jacobian(point), full.jacobian(point))


def test_the_first_number_that_is_not_finite_is_named(nlp, problem, point):
    assert nlp.first_nonfinite(point) is None
    well = logarithm_well()
    assert _engine.Nlp(**arguments(well)).first_nonfinite(np.array([0.0, 2.0])) == (0, 0, "cost", 0)
    point[5 * 3 + 1] = np.nan
    group, stage, output, _ = nlp.first_nonfinite(point)
    assert (group, stage, output) == (0, 3, "cost") or (group, stage, output) == (0, 3, "rows")


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("n_x", lambda _: 0),
        ("n_x", lambda _: "many"),
        ("threads", lambda _: 0),
        ("a_indptr", lambda v: v[:-1]),
        ("a_indices", lambda v: v + 1000),
        ("jac_const", lambda v: v[:-1]),
        ("jac_row", lambda v: v + 1000),
        ("hess_row", lambda v: v * 0),
        ("groups", lambda v: v[0]),
        ("x_offset", lambda v: v + 1000),
        ("gather_data", lambda v: v[:-1]),
        ("gather_indices", lambda v: v + 5),
        ("nloc", lambda _: 2.5),
        ("p", lambda v: v[:-1]),
        ("cost_weight", lambda v: v[:-1]),
        ("row", lambda v: v[:, :-1].copy()),
        ("row", lambda v: -v - 1),
        ("row_scale", lambda v: v[:-1]),
        ("jac_src", lambda v: v + 1000),
        ("jac_target", lambda v: v[:, :-1].copy()),
        ("hess_target", lambda v: v + 100000),
        ("value", lambda _: "not a tape"),
        ("value", lambda _: None),
        ("second", lambda _: _engine.Tape(ca.Function("second", [ca.SX.sym("z")], []))),
    ],
)
def test_wrong_input_is_refused_in_one_line_that_names_it(problem, key, change):
    with pytest.raises(ValueError, match=key) as refused:
        _engine.Nlp(**changed(arguments(problem), key, change))
    assert "\n" not in str(refused.value)


def test_a_missing_entry_is_refused_by_name(problem):
    given = arguments(problem)
    del given["hess_row"]
    with pytest.raises(ValueError, match="hess_row"):
        _engine.Nlp(**given)


# Products and sums may be rounded once together, and only there.
TAPES_ROUNDING = 1e-13


def values(function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """Nonzeros of the outputs at each point, by CasADi."""
    points = [function.call([part[k] for part in inputs]) for k in range(len(inputs[0]))]
    return [np.array([np.array(point[i].nonzeros()) for point in points]) for i in range(function.n_out())]


def assert_same(function: ca.Function, n: int, low: float = -2.0, high: float = 2.0, seed: int = 0) -> None:
    draw = np.random.default_rng(seed)
    inputs = [draw.uniform(low, high, (n, function.nnz_in(i))) for i in range(function.n_in())]
    for got, wanted in zip(_engine.Tape(function)(inputs), values(function, inputs), strict=True):
        assert_allclose(got, wanted.reshape(got.shape), rtol=TAPES_ROUNDING, atol=TAPES_ROUNDING)


x, y, z = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("z")
OPERATIONS = {
    "sums": [x + y, x - y, y - x, -x, x + x, 2 * x],
    "products": [x * y, x * x, x * y + z, z + x * y, z - x * y, x * y - z, x * y + x * z, x * y - x * y],
    "quotients": [x / y, 1 / x, x / 3],
    "powers": [ca.sqrt(x), ca.exp(x), ca.log(x), x**y, x**3, ca.log1p(x), ca.expm1(x), ca.hypot(x, y)],
    "angles": [ca.sin(x), ca.cos(x), ca.tan(x), ca.atan2(x, y), ca.asin(x / 3), ca.acos(x / 3), ca.atan(x)],
    "hyperbolic": [ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x), ca.acosh(1 + x), ca.atanh(x / 3)],
    "corners": [ca.fabs(x), ca.fmin(x, y), ca.fmax(x, y), ca.sign(x - y), ca.floor(x), ca.ceil(x)],
    "conditions": [ca.if_else(x < y, x, z), ca.if_else(x <= 1, y, 0), ca.logic_and(x < 1, y < 1), x == x],
    "more": [ca.fmod(x, y), ca.copysign(x, y - 1), ca.erf(x), ca.logic_not(x < y), ca.logic_or(x < 1, y < 1)],
}


@pytest.mark.parametrize("size", REGISTERS)
@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_give_the_numbers_of_the_virtual_machine(name, size):
    with registers(size):
        assert_same(ca.Function("f", [x, y, z], OPERATIONS[name]), n=13, low=0.1)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 40])
def test_any_number_of_points_gives_the_same_bits(n):
    function = ca.Function("f", [x, y], [ca.sin(x) * y + x * x, y / x])
    inputs = [np.linspace(0.5, 3.0, 40)[:, None], np.linspace(-1.0, 1.0, 40)[:, None]]
    tape = _engine.Tape(function)
    for some, all_of_them in zip(tape([part[:n] for part in inputs]), tape(inputs), strict=True):
        assert_array_equal(some, all_of_them[:n])


@pytest.mark.parametrize("seed", range(20))
def test_random_expressions_give_the_numbers_of_the_virtual_machine(seed):
    draw = np.random.default_rng(seed)
    inputs = [ca.SX.sym("a", 4), ca.SX.sym("b", 3)]
    known = [*ca.vertsplit(ca.vertcat(*inputs)), ca.SX(1.5), ca.SX(-0.25)]
    makers = [
        lambda p, q: p * q, lambda p, q: p + q, lambda p, q: p - q, lambda p, q: -p, lambda p, q: ca.sin(p),
        lambda p, q: p * q + known[0], lambda p, q: p - q * q,
    ]  # fmt: skip
    for _ in range(3000):
        one, other = draw.integers(max(0, len(known) - 60), len(known), 2)
        made = makers[draw.integers(len(makers))](known[one], known[other])
        known.append(made / (1 + ca.fabs(made)) if draw.random() < 0.3 else made / 2)
    matrix = ca.reshape(ca.vertcat(*known[-12:]), 4, 3)
    matrix[1, 1] = 0
    results = [ca.vertcat(*known[5::97]), ca.sparsify(ca.SX(matrix)), inputs[0], ca.SX(2, 2)]
    assert_same(ca.Function("f", inputs, results), n=9, seed=seed)


def test_derivatives_of_a_robot_are_those_of_the_virtual_machine():
    for group in transcribe(hop(), "legendre:2", 4).groups:
        made = Derivatives(group.point)
        for function in (made.value, made.first, made.second):
            assert_same(function, n=3, low=0.2, high=0.8)


def test_an_expression_that_occurs_twice_is_evaluated_once():
    twice = ca.sin(x * y) + ca.cos(y * x) * ca.sin(y * x)
    assert (
        _engine.Tape(ca.Function("f", [x, y], [twice])).statements == 4
    )  # product, sine, cosine, sum of both


def test_what_no_output_needs_is_left_out():
    tape = _engine.Tape(ca.Function("f", [x, y], [x + 1, 3, y, 0, x]))
    assert tape.statements == 1
    assert_array_equal(np.ravel(tape([np.array([[2.0]]), np.array([[5.0]])])), [3.0, 3.0, 5.0, 0.0, 2.0])


def test_numbers_that_are_not_finite_stay_at_their_points():
    root = _engine.Tape(ca.Function("f", [x], [ca.sqrt(x), 1 / x]))
    got = np.hstack(root([np.array([[4.0], [-1.0], [0.0], [np.nan]])]))
    assert_array_equal(got, [[2.0, 0.25], [np.nan, -1.0], [0.0, np.inf], [np.nan, np.nan]])


def test_patterns_are_those_of_the_outputs():
    sparse = ca.SX(3, 4)
    sparse[2, 0], sparse[0, 3] = x, y
    rows, columns = _engine.Tape(ca.Function("f", [x, y], [x, sparse])).pattern(1)
    assert list(zip(rows, columns, strict=True)) == [(2, 0), (0, 3)]


def test_bytes_are_read_as_the_same_tape():
    function = ca.Function("f", [x, y, z], [*OPERATIONS["products"], *OPERATIONS["conditions"]])
    tape = _engine.Tape(function)
    again = _engine.Tape.read(tape.bytes())
    inputs = [np.full((2, 1), value) for value in (0.3, 0.7, -0.2)]
    assert_array_equal(np.hstack(again(inputs)), np.hstack(tape(inputs)))
    assert (again.statements, again.slots) == (tape.statements, tape.slots)
    assert_array_equal(again.pattern(0), tape.pattern(0))


def test_bytes_that_are_no_tape_are_refused_or_stay_within_their_work():
    whole = _engine.Tape(ca.Function("f", [x, y], [x * y + ca.sin(x), y])).bytes()
    for end in range(len(whole)):
        with pytest.raises(ValueError, match="tape"):
            _engine.Tape.read(whole[:end])
    with pytest.raises(ValueError, match="damaged"):
        _engine.Tape.read(whole + b"\0")
    inputs = [np.full((1, 1), 0.5)] * 2
    for place in range(len(_engine.TAPE_VERSION), len(whole)):
        for byte in (0, 1, 127, 255):
            try:
                tape = _engine.Tape.read(whole[:place] + bytes([byte]) + whole[place + 1 :])
            except ValueError:
                continue
            try:
                tape(inputs)
            except ValueError as refused:
                assert "input" in str(refused)  # noqa: PT017 (a tape of other sizes)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [(ca.Function("f", [ca.MX.sym("x")], [1]), "scalar operations"), ("f", "a Tape needs a casadi.Function")],
)
def test_what_is_no_function_of_scalar_operations_is_refused(given, wanted):
    with pytest.raises(ValueError, match=wanted):
        _engine.Tape(given)


def test_inputs_of_another_shape_are_refused():
    tape = _engine.Tape(ca.Function("f", [ca.SX.sym("x", 3), y], [y]))
    with pytest.raises(ValueError, match=r"input 0 must have the shape \(points, 3\)"):
        tape([np.zeros((2, 2)), np.zeros((2, 1))])
    with pytest.raises(ValueError, match=r"input 1 must have the shape \(points, 1\)"):
        tape([np.zeros((2, 3)), np.zeros((1, 1))])
    with pytest.raises(ValueError, match="all its inputs"):
        tape([np.zeros((2, 3))])


N_Z, N_WINDOW, N_ROWS = 9, 7, 5


def random_gather(generator: np.random.Generator) -> SparseMatrix:
    dense = generator.uniform(-1, 1, (N_Z, N_WINDOW)) * (generator.uniform(size=(N_Z, N_WINDOW)) < 0.4)
    dense[3] = 0.0  # an input that depends on nothing
    return SparseMatrix.of(dense)


def random_matrix(generator: np.random.Generator, rows: int, density: float) -> tuple[Pattern, np.ndarray]:
    """A pattern and a dense matrix that is zero outside it."""
    present = generator.uniform(size=(rows, N_Z)) < density
    return np.nonzero(present), generator.uniform(-1, 1, (rows, N_Z)) * present


def nonzeros(pattern: Pattern, dense: np.ndarray) -> np.ndarray:
    return dense[pattern]


def applied(found: DerivativeMap, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """What the engine computes from a map: each target a sum of coefficients times nonzeros."""
    dense = np.zeros(shape)
    for target, (row, column) in enumerate(zip(found.row, found.column, strict=True)):
        entries = slice(found.indptr[target], found.indptr[target + 1])
        dense[row, column] += found.coefficient[entries] @ values[found.source[entries]]
    return dense


@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_jacobian_map_is_the_scaled_product_with_the_gather_matrix(seed, density):
    generator = np.random.default_rng(seed)
    gather, (pattern, dense) = random_gather(generator), random_matrix(generator, N_ROWS, density)
    scale = generator.uniform(0.1, 2, N_ROWS)
    found = jacobian_map(pattern, gather, scale)
    expected = scale[:, None] * dense @ gather.toarray()
    assert_allclose(applied(found, nonzeros(pattern, dense), expected.shape), expected, atol=TAPES_ROUNDING)


@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_hessian_map_is_the_lower_triangle_of_the_congruence(seed, density):
    generator = np.random.default_rng(seed)
    gather, (_, dense) = random_gather(generator), random_matrix(generator, N_Z, density)
    lower = np.tril(dense)
    pattern = np.nonzero(lower)
    found = hessian_map(pattern, gather)
    symmetric = lower + np.tril(lower, -1).T
    expected = np.tril(gather.toarray().T @ symmetric @ gather.toarray())
    assert_allclose(applied(found, nonzeros(pattern, lower), expected.shape), expected, atol=TAPES_ROUNDING)
    assert np.all(found.row >= found.column)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_matrices_are_scipys(count):
    """Entries at one place are added; those that are zero are kept."""
    generator = np.random.default_rng(3)
    row, column = generator.integers(0, N_ROWS, count), generator.integers(0, N_Z, count)
    value = generator.uniform(-1, 1, count) * (generator.uniform(size=count) < 0.8)
    expected = sparse.csr_matrix((value, (row, column)), shape=(N_ROWS, N_Z))
    found = SparseMatrix.of_entries((N_ROWS, N_Z), row, column, value)
    for made, scipys in ((found, expected), (SparseMatrix.of(found.toarray()), expected)):
        if made is not found:
            scipys.eliminate_zeros()
        assert_array_equal(made.indptr, scipys.indptr)
        assert_array_equal(made.indices, scipys.indices)
        assert_allclose(made.data, scipys.data, atol=TAPES_ROUNDING)
        assert_array_equal(made.row, scipys.tocoo().row)
    assert_allclose(found.toarray(), expected.toarray(), atol=TAPES_ROUNDING)


def test_every_target_of_a_map_is_named_once():
    generator = np.random.default_rng(2)
    gather, (pattern, _) = random_gather(generator), random_matrix(generator, N_ROWS, 0.5)
    found = jacobian_map(pattern, gather, np.ones(N_ROWS))
    places = np.stack([found.row, found.column])
    assert np.unique(places, axis=1).shape == places.shape
    assert np.all(np.diff(found.indptr) > 0)
