"""Tapes against CasADi's virtual machine, and maps of derivatives against dense products."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from tests.support.problems import hop
from tests.support.registers import REGISTERS, registers
from trajopt import _engine
from trajopt.transcription import Derivatives, transcribe
from trajopt.transcription.sparse_maps import DerivativeMap, Pattern, SparseMatrix, hessian_map, jacobian_map

# Products and sums may be rounded once together, and only there.
ROUNDING = 1e-13


def values(function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """Nonzeros of the outputs at each point, by CasADi."""
    points = [function.call([part[k] for part in inputs]) for k in range(len(inputs[0]))]
    return [np.array([np.array(point[i].nonzeros()) for point in points]) for i in range(function.n_out())]


def assert_same(function: ca.Function, n: int, low: float = -2.0, high: float = 2.0, seed: int = 0) -> None:
    draw = np.random.default_rng(seed)
    inputs = [draw.uniform(low, high, (n, function.nnz_in(i))) for i in range(function.n_in())]
    for got, wanted in zip(_engine.Tape(function)(inputs), values(function, inputs), strict=True):
        assert_allclose(got, wanted.reshape(got.shape), rtol=ROUNDING, atol=ROUNDING)


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
    assert_allclose(applied(found, nonzeros(pattern, dense), expected.shape), expected, atol=ROUNDING)


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
    assert_allclose(applied(found, nonzeros(pattern, lower), expected.shape), expected, atol=ROUNDING)
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
        assert_allclose(made.data, scipys.data, atol=ROUNDING)
        assert_array_equal(made.row, scipys.tocoo().row)
    assert_allclose(found.toarray(), expected.toarray(), atol=ROUNDING)


def test_every_target_of_a_map_is_named_once():
    generator = np.random.default_rng(2)
    gather, (pattern, _) = random_gather(generator), random_matrix(generator, N_ROWS, 0.5)
    found = jacobian_map(pattern, gather, np.ones(N_ROWS))
    places = np.stack([found.row, found.column])
    assert np.unique(places, axis=1).shape == places.shape
    assert np.all(np.diff(found.indptr) > 0)
