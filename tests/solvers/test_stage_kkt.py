"""KKT systems stage by stage against a dense solver, and steps of the interior point."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag

import trajopt
from tests.support.registers import REGISTERS, registers
from trajopt import InputError, _engine
from trajopt.solving.solving import solve
from trajopt.transcription import transcribe
from trajopt.transcription.compilation import compile_points, entry_key
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.nlp import Nlp, assemble
from trajopt_library import problems

# Residuals over the size of matrix and solution, after one refinement.
RESIDUAL = 1e-12
SAME_OPTIMUM = 1e-5
STAGES, MUMPS = ({"linear_solver": name} for name in ("stages", "mumps"))


@dataclass
class Random:
    """A random KKT system in stages.

    sizes: of nodes and controls in turn. gap: rows that join neighbouring nodes; local: rows of a stage;
    loop: rows that join the first and the last node. delta: regularisation of equalities. curvature: of
    controls, over that of nodes. slacks: variables in one row only. limbs: parts of a stage, of which
    each inequality has entries in one, and in the first quarter of the variables.
    """

    seed: int = 0
    node: int = 5
    control: int = 7
    n: int = 6
    local: int = 4
    unequal: int = 6
    loop: int = 0
    delta: float = 0.0
    convex: float = 3.0
    curvature: float = 1.0
    repeated: bool = False
    slacks: int = 0
    limbs: int = 1

    def build(self):
        rng = np.random.default_rng(self.seed)
        sizes = [size for _ in range(self.n) for size in (self.node, self.control)] + [self.node]
        numbers = [number for k in range(self.n) for number in (k, -1 - k)] + [self.n]
        stage = np.repeat(numbers, sizes)
        n_x = len(stage)

        def of(*wanted):
            return np.flatnonzero(np.isin(stage, wanted))

        def rows(count, columns):
            found = np.zeros((count, n_x))
            found[:, columns] = rng.normal(size=(count, len(columns)))
            return found

        hessian = np.zeros((n_x, n_x))
        equal, unequal = [np.zeros((0, n_x))], [np.zeros((0, n_x))]
        for k in range(self.n):
            own = of(k, -1 - k)
            part = rng.normal(size=(len(own), len(own)))
            weight = np.where(stage[own] < 0, np.sqrt(self.curvature), 1.0)
            part = part + part.T + 2 * self.convex * np.eye(len(own))
            hessian[np.ix_(own, own)] += weight[:, None] * part * weight
            equal.append(rows(self.local, own))
            gap = rows(self.node, own)
            gap[:, of(k + 1)] = np.eye(self.node)
            equal.append(gap)
            bounded = rows(self.unequal, own)
            if self.limbs > 1:
                limb, place = np.arange(self.unequal)[:, None] % self.limbs, np.arange(len(own))
                bounded[:, own] *= (place % self.limbs == limb) | (place < len(own) / 4)
            unequal += [bounded, rows(1, of(-1 - k)[:2])]
        hessian[np.ix_(of(self.n), of(self.n))] += self.convex * np.eye(self.node)
        if self.loop:
            equal.append(rows(self.loop, of(0, self.n)))
        if self.repeated:
            equal.append(equal[1][:1])
        rows, n_equal = np.vstack([*equal, *unequal]), sum(map(len, equal))
        slacks = np.zeros((len(rows), self.slacks))
        slacks[rng.integers(len(rows), size=self.slacks), np.arange(self.slacks)] = rng.choice([-1.0, 1.0])
        hessian = block_diag(hessian, np.diag(10.0 ** rng.uniform(-6, 6, self.slacks)))
        stage = np.append(stage, np.full(self.slacks, _engine.ALONE)).astype(np.int32)
        rows = np.hstack([rows, slacks])
        return stage, hessian, rows[:n_equal], rows[n_equal:], rng

    def system(self):
        stage, hessian, equal, unequal, rng = self.build()
        n_x, n_c, n_d = len(stage), len(equal), len(unequal)
        slacks = np.diag(10.0 ** rng.uniform(-8, 8, n_d))
        matrix = np.block(
            [
                [hessian, np.zeros((n_x, n_d)), equal.T, unequal.T],
                [np.zeros((n_d, n_x)), slacks, np.zeros((n_d, n_c)), -np.eye(n_d)],
                [equal, np.zeros((n_c, n_d)), -self.delta * np.eye(n_c), np.zeros((n_c, n_d))],
                [unequal, -np.eye(n_d), np.zeros((n_d, n_c)), -self.delta * np.eye(n_d)],
            ]
        )
        return stage, n_c, n_d, matrix, rng.normal(size=len(matrix))


def by_stages(stage, n_c, n_d, matrix, rhs, threads=1):
    row, column = np.nonzero(np.tril(matrix))
    value = matrix[row, column]
    return _engine.solve_kkt(
        len(stage), n_c, n_d, stage, row.astype(np.int32), column.astype(np.int32), value, rhs, threads
    )


def assert_solved(stage, n_c, n_d, matrix, rhs):
    solution, negative = by_stages(stage, n_c, n_d, matrix, rhs)
    solution = solution + by_stages(stage, n_c, n_d, matrix, rhs - matrix @ solution)[0]
    scale = np.abs(matrix).max(axis=1) * np.abs(solution).max() + np.abs(rhs)
    assert np.max(np.abs(matrix @ solution - rhs) / scale) <= RESIDUAL
    root = 1 / np.sqrt(np.abs(matrix).max(axis=1))  # inertia does not change by scaling
    assert negative == np.count_nonzero(np.linalg.eigvalsh(root[:, None] * matrix * root) < 0)


SYSTEMS = {
    "usual": Random(),
    "another": Random(seed=1),
    "one stage": Random(n=1),
    "many stages": Random(n=40),
    "wide": Random(node=37, control=60, local=36, unequal=40, n=4),
    "indefinite": Random(convex=-1.0),
    "regularised": Random(delta=1e-8),
    "periodic": Random(loop=3),
    "no rows but gaps": Random(local=0, unequal=0),
    "no controls": Random(control=2, local=0, unequal=0),
    "nodes with more rows than unknowns": Random(node=2, control=9, local=8, unequal=1),
    "repeated rows, regularised": Random(repeated=True, delta=1e-6),
    "hardly any curvature": Random(curvature=1e-12, local=2),
    "slacks": Random(slacks=100),
    "slacks in a periodic system": Random(slacks=100, loop=3, delta=1e-8),
    "limbs": Random(node=24, control=40, local=20, unequal=30, n=4, limbs=4),
    "limbs without curvature": Random(node=24, control=40, local=6, unequal=30, n=4, limbs=3, curvature=0.0),
    "no curvature": Random(curvature=0.0, local=2, node=6),
}


@pytest.mark.parametrize("size", [0, 8, 24, 128])
def test_registers_that_no_processor_has_are_refused(size):
    with pytest.raises(ValueError, match="bytes must be 16, 32 or 64"):
        _engine.use_registers(size)


@pytest.mark.parametrize("size", REGISTERS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_solutions_and_inertia_are_those_of_a_dense_solver(name, size):
    with registers(size):
        assert_solved(*SYSTEMS[name].system())


@pytest.mark.parametrize("seed", range(5))
def test_periodic_indefinite_systems_are_solved(seed):
    assert_solved(*Random(seed=seed, loop=4, convex=0.0, n=9).system())


def test_first_node_may_have_no_unknowns():
    stage, n_c, n_d, matrix, rhs = Random().system()
    kept = np.concatenate([stage != 0, np.ones(len(matrix) - len(stage), bool)])
    assert_solved(stage[stage != 0], n_c, n_d, matrix[np.ix_(kept, kept)], rhs[kept])


def test_rows_of_the_last_node_alone_are_solved_together_with_what_is_before_it():
    stage, n_c, n_d, matrix, rhs = Random(control=12).system()
    fixed = np.zeros((3, len(matrix)))
    fixed[:, np.flatnonzero(stage == stage.max())[:3]] = np.eye(3)
    at = len(stage) + n_d
    grown = np.insert(np.insert(matrix, [at] * 3, fixed, axis=0), [at] * 3, 0.0, axis=1)
    grown[:, at : at + 3] = grown[at : at + 3].T
    assert_solved(stage, n_c + 3, n_d, grown, np.insert(rhs, at, np.zeros(3)))


@pytest.mark.parametrize("name", SYSTEMS)
def test_two_threads_give_the_bits_of_one(name):
    one, two = (by_stages(*SYSTEMS[name].system(), threads=threads) for threads in (1, 2))
    assert_array_equal(one[0], two[0])
    assert one[1] == two[1]


@pytest.mark.parametrize("factors", [(0.0, 0.0), (1.0, 0.0), (0.3, -0.7)])
@pytest.mark.parametrize("first", [0, 4])
def test_dependent_rows_are_singular(first, factors):
    stage, n_c, n_d, matrix, rhs = Random().system()
    at = len(stage) + n_d + first
    matrix[at] = factors[0] * matrix[at + 1] + factors[1] * matrix[at + 2]
    matrix[:, at] = matrix[at]
    assert by_stages(stage, n_c, n_d, matrix, rhs) is None


def test_variables_without_curvature_or_rows_are_singular():
    stage, n_c, n_d, matrix, rhs = Random().system()
    matrix[stage.size - 9], matrix[:, stage.size - 9] = 0.0, 0.0
    assert by_stages(stage, n_c, n_d, matrix, rhs) is None


def test_sizes_that_do_not_fit_are_refused():
    stage, n_c, n_d, matrix, rhs = Random().system()
    with pytest.raises(ValueError, match="rhs has a wrong size"):
        by_stages(stage[:-1], n_c, n_d, matrix, rhs)
    with pytest.raises(ValueError, match="a slack is coupled with a variable"):
        by_stages(np.append(stage, [0, 0]).astype(np.int32), n_c, n_d - 1, matrix, rhs)
    with pytest.raises(ValueError, match="a multiplier is coupled with another"):
        by_stages(stage[:-1], n_c + 1, n_d, matrix, rhs)
    alone = np.append(_engine.ALONE, stage[1:]).astype(np.int32)
    with pytest.raises(ValueError, match="a variable that is alone is coupled with another"):
        by_stages(alone, n_c, n_d, matrix, rhs)
    matrix[:, 0] = 0.0
    matrix[-2:, 0] = 1.0
    with pytest.raises(ValueError, match="a variable that is alone is in two rows"):
        by_stages(alone, n_c, n_d, matrix, rhs)


def test_every_variable_has_the_number_of_its_node_or_stage():
    layout = transcribe(problems.load("hopper-gait")).layout
    numbers = layout.stage_numbers
    assert numbers.shape == (layout.n_unknowns,)
    for k in range(layout.n_stages):
        node, window = layout.node(k), layout.window(k)
        assert set(numbers[node]) == {k}
        assert set(numbers[node.stop : window.stop]) <= {-1 - k}
    assert set(numbers[layout.node(layout.n_stages)]) == {layout.n_stages}


CASES = {
    "hop": ("hopper-hop", {}),
    "periodic gait with impacts": ("hopper-gait", {}),
    "least time": ("arm-transfer", {"robot": "z1", "goal": "time"}),
    "least time of long arms": ("arm-transfer", {"robot": "xarm7"}),
    "trot": ("quadruped-trot", {"robot": "solo12"}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_solves_reach_the_optimum_of_ipopts_own_linear_solver(name):
    family, values = CASES[name]
    own, usual = (
        solve(problems.load(family, **values), judge=False, options=options) for options in (STAGES, MUMPS)
    )
    assert own.converged
    assert own.statistics.iterations <= 1.1 * usual.statistics.iterations
    assert_allclose(own.statistics.objective, usual.statistics.objective, rtol=SAME_OPTIMUM)


@pytest.mark.long
def test_solves_with_two_threads_end_at_the_same_bits():
    one, two = (solve(problems.load("quadruped-trot"), judge=False, threads=threads) for threads in (1, 2))
    assert one.statistics.iterations == two.statistics.iterations
    assert_array_equal(one.q, two.q)
    assert_array_equal(one.tau, two.tau)


def test_fewer_free_variables_than_rows_still_end():
    found = solve(
        problems.load("ur5-reach", duration=0.05), intervals=1, transcription="legendre:1",
        judge=False, options=STAGES,
    )  # fmt: skip
    assert not found.converged


def test_hessian_of_gradients_is_refused():
    with pytest.raises(InputError, match="linear_solver=stages"):
        solve(problems.load("ur5-reach"), hessian="limited-memory", options=STAGES)


SMALL_BARRIER = 1e-9
STEPPED_OPTIMUM = 1e-6


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
    assert_allclose(
        nlp.engine.f(iterate["x"]),
        best["f"],
        rtol=STEPPED_OPTIMUM,
        atol=STEPPED_OPTIMUM,
    )
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
