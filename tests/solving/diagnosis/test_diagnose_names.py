"""Parts of a diagnosis: names of unknowns and rows, values that are not finite, ranks and curvature."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy import linalg, sparse

import trajopt
from tests.support.diagnosed import snapshot_of, solved
from tests.support.problems import hop, reach
from trajopt.robot.units import Units
from trajopt.solving.diagnosis import curvature as curving
from trajopt.solving.diagnosis import rank
from trajopt.solving.diagnosis.curvature import curvature, lanczos
from trajopt.solving.diagnosis.diagnose import diagnose
from trajopt.solving.diagnosis.diagnosis import Diagnosis
from trajopt.solving.diagnosis.rank import dependencies, spectrum
from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare, solve
from trajopt.terms import Context, Cost, NodeConstraint, NodePlace, PointConstraint, Rows
from trajopt_library import problems


def test_a_solutions_own_unknowns_and_multipliers_are_stationary():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    assert snapshot.stationarity is not None
    assert snapshot.stationarity < 1e-5
    assert snapshot.complementarity < 1e-5
    assert snapshot.violations.max() < 1e-6


@pytest.mark.long
def test_an_unknown_changes_what_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    transcription, names = snapshot.transcription, snapshot.names
    model, before = problem.robot.model, extract(transcription, snapshot.x, success=True, converged=True)
    seen = set()
    for index in range(0, len(snapshot.x), 7):
        label, site = names.unknown_labels[index], names.unknown_sites[index]
        if label.owner in ("base", "") or label.kind == "time scale":
            continue
        moved = snapshot.x.copy()
        moved[index] += 0.1
        after = extract(transcription, moved, success=True, converged=True)
        arrays = {"position": "q", "rate": "v", "acceleration": "a", "force": "f"}
        array = arrays[label.kind]
        changed = np.abs(getattr(after, array) - getattr(before, array)).reshape(len(before.t), -1) > 1e-6
        at = np.abs(before.t - names.time(site)) < 1e-9
        if label.kind == "force":
            column = {"x": 0, "y": 1, "z": 2}[label.quantity[-1]]
        else:
            joint = model.joints[model.getJointId(label.owner)]
            column = joint.idx_q if label.kind == "position" else joint.idx_v
        assert changed[at][:, column].any(), names.unknown_labels[index]
        others = np.delete(changed[at & before.collocation], column, axis=1)
        if site.point >= 0:
            assert not others.any(), names.unknown_labels[index]
        seen.add(label.kind)
    assert seen == {"position", "rate", "acceleration", "force"}


def test_a_row_of_a_limit_is_the_torque_that_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    names, unit = snapshot.names, Units(problem.robot).torque
    rows = [row for row in range(len(snapshot.g)) if names.block(row) == "torque_limits"]
    assert len(rows) == 2 * 2 * 8
    joints = list(problem.robot.model.names)[2:]
    for row in rows:
        name = names.row(row)
        assert name.about in [f"{joint} torque" for joint in joints]
        column = joints.index(name.about.split()[0])
        sample = int(np.argmin(np.abs(solution.t - names.time(name.site)) + ~solution.collocation))
        assert snapshot.g[row] * unit == pytest.approx(solution.tau[sample, column], abs=1e-6 * unit)


def test_rows_are_named_by_contact_axis_and_state():
    problem, solution = solved("hop")
    names = snapshot_of(problem, solution).names
    texts = {names.row(row).what for row in range(names.transcription.n_rows)}
    assert "contact_acceleration [foot acceleration y]" in texts
    assert "base_dynamics [base turn about x balance]" in texts
    assert "contact_landing [foot position z]" in texts
    assert "frame_height [foot position z]" in texts
    assert "defect [hip rate]" in texts
    assert "velocity_limits [shank rate]" in texts


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("hopper-hop", {"touchdown": "impact"}, {"jump", "impulse", "force"}),
        ("hopper-hop", {"coordinates": "minimal"}, {"position", "rate", "acceleration"}),
        ("hopper-hop", {"goal": "time"}, {"time scale"}),
        ("hopper-gait", {}, {"position", "rate"}),
        ("ur5-reach", {"actuation": "velocity"}, {"position", "rate"}),
        ("arm-pick-place", {}, {"position"}),
    ],
)
def test_every_unknown_and_row_has_a_name(name, values, expected):
    prepared = prepare(problems.load(name, **values), intervals=8)
    snapshot = Snapshot(nlp=prepared.nlp, x=prepared.guess)
    names = snapshot.names
    assert all(label.owner and label.quantity for label in names.unknown_labels)
    assert expected <= {label.kind for label in names.unknown_labels}
    pairs = list(zip(names.unknown_labels, names.unknown_sites, strict=True))
    assert len(set(pairs)) == len(pairs)
    rows = [names.row(row) for row in range(prepared.transcription.n_rows)]
    assert len(set(rows)) == len(rows)
    assert not [row for row in rows if row.about.startswith("row ") and "mostly" not in row.about]


@pytest.mark.slow
def test_the_jump_at_its_defaults_is_clean():
    problem = problems.load("solo12-jump")
    solution = trajopt.solve(problem, fixed_mesh=True)
    found = diagnose(solution)  # its problem from the catalogue
    assert found.variables == 4575
    assert found.clean, [str(advice) for advice in found.advice]
    snapshot = snapshot_of(problem, solution)
    matrix = snapshot.jacobian[snapshot.active_rows][:, snapshot.free]
    flight = [i for i, row in enumerate(snapshot.active_rows) if names_phase(snapshot, int(row)) == "flight"]
    values = np.linalg.svd(matrix[flight].toarray(), compute_uv=False)
    report = next(report for report in found.ranks if report.phase == "flight")
    assert (report.rows, report.rank) == (len(flight), len(flight))
    assert report.condition == pytest.approx(values[0] / values[-1], rel=1e-3)


def names_phase(snapshot: Snapshot, row: int) -> str:
    return snapshot.names.phase(snapshot.names.sites[row].stage)


@dataclass(frozen=True, kw_only=True)
class RootOfPosition(PointConstraint):
    """The root of a joint's position less ``least``: no number where the joint is below it."""

    joint: int = -1
    least: float = 0.5

    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(ca.sqrt(context.xi[self.joint] - self.least), 0, np.inf, 1.0)


@dataclass(frozen=True, kw_only=True)
class SpeedCost(Cost):
    """The length of the joints' rates, not squared: no slope at rest."""

    def residual(self, context: Context, units: Units) -> ca.SX:
        return ca.sqrt(ca.norm_2(context.dxi[-2:]))


@dataclass(frozen=True, kw_only=True)
class LogOfForce(PointConstraint):
    """The logarithm of a contact's normal force less half the weight."""

    def rows(self, context: Context, units: Units) -> Rows | None:
        if not context.contacts:
            return None
        force = context.wrenches["foot"][2] / units.force
        return Rows.create(ca.log(force - 2.0), -np.inf, np.inf, 1.0)


@dataclass(frozen=True, kw_only=True)
class RootOfHeight(NodeConstraint):
    """The root of a foot's height less a metre, at the middle of the flight."""

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == "flight" and place.index == 1

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(ca.sqrt(context.frame("foot").position[2] - 10.0), 0, np.inf, 1.0)


def with_term(term: object) -> Diagnosis:
    problem = hop()
    return diagnose(prepare(replace(problem, terms=(*problem.terms, term))))


def test_a_root_of_a_negative_number_names_term_place_and_joint():
    found = with_term(RootOfPosition(during="flight")).nonfinite
    assert found is not None
    assert (found.output, found.terms, found.phase) == ("rows", ("root_of_position",), "flight")
    assert found.point == 0
    assert [entry.name for entry in found.inputs] == ["shank position"]
    assert found.inputs[0].value == pytest.approx(0.0, abs=0.5)
    assert "shank position" in found.row


def test_a_slope_without_value_names_the_cost_and_the_rates():
    found = with_term(SpeedCost(weight=1.0, during="landing")).nonfinite
    assert found is not None
    assert found.terms == ("speed_cost",)
    assert found.output in ("gradient", "jacobian", "hessian")
    assert {entry.name for entry in found.inputs} == {"hip rate", "shank rate"}
    assert found.phase == "landing"


def test_a_logarithm_of_a_force_names_the_contact():
    found = with_term(LogOfForce(during="stance")).nonfinite
    assert found is not None
    assert found.terms == ("log_of_force",)
    assert [entry.name for entry in found.inputs] == ["foot force z"]


def test_a_node_term_is_found_at_its_node():
    found = with_term(RootOfHeight()).nonfinite
    assert found is not None
    assert (found.terms, found.phase, found.point) == (("root_of_height",), "flight", None)
    assert "base z position" in [entry.name for entry in found.inputs]


def test_an_unknown_that_is_no_number_is_named_itself():
    prepared = prepare(hop())
    names = diagnose(prepared)
    assert names.nonfinite is None
    wrong = prepared.guess.copy()
    layout = prepared.transcription.layout
    phase, k = 1, int(layout.intervals_of(1)[0])
    window = np.arange(layout.n_unknowns)[layout.window(k)]
    wrong[window[layout.local_derivative(phase, 0)[-1]]] = np.nan
    found = diagnose(replace(prepared, guess=wrong))
    assert found.nonfinite is not None
    assert [entry.name for entry in found.nonfinite.inputs] == ["shank acceleration"]
    assert found.max_violation is None
    assert found.ranks == ()
    assert any("the guess itself is not finite" in advice.remedy for advice in found.advice)


def test_a_solve_that_cannot_start_is_diagnosed_from_its_solution():
    problem = reach()
    broken = replace(problem, terms=(*problem.terms, RootOfPosition(least=0.2)))
    solution = solve(broken)
    assert solution.statistics.status == "not_finite"
    found = diagnose(solution, broken)
    assert found.nonfinite is not None
    assert [entry.name for entry in found.nonfinite.inputs] == ["joint position"]
    assert "root_of_position" in str(found)


# The largest singular value against LAPACK's, relative; the smallest is iterated as far as it is told to.
SAME = 1e-6
# Smallest curvature by Lanczos, relative: 40 steps of a well-separated spectrum.
CURVATURE = 1e-4
# What a null vector leaves: rounding of a well-scaled matrix.
NULL = 1e-9


def banded(m: int, n: int, seed: int) -> sparse.csr_matrix:
    """Random rows over a sliding window of columns, as collocation makes them."""
    generator = np.random.default_rng(seed)
    dense = np.zeros((m, n))
    width = 30
    for row in range(m):
        start = int((n - width) * row / m)
        dense[row, start : start + width] = generator.standard_normal(width)
    return sparse.csr_matrix(dense)


def with_copies(matrix: sparse.csr_matrix) -> tuple[sparse.csr_matrix, list[set[int]]]:
    """The matrix with a copy of row 3, the sum of rows 10 and 20, and twice row 200; the groups they make."""
    m = matrix.shape[0]
    extra = [matrix[3], matrix[10] + matrix[20], 2 * matrix[200]]
    return sparse.vstack([matrix, *extra], format="csr"), [{3, m}, {10, 20, m + 1}, {200, m + 2}]


def test_the_sparse_spectrum_is_that_of_lapack():
    matrix = banded(450, 600, 0)
    found = rank._sparse(matrix)
    values = np.linalg.svd(matrix.toarray(), compute_uv=False)
    assert (found.rank, found.nullity, found.complete) == (450, 0, True)
    assert found.largest == pytest.approx(values[0], rel=SAME)
    assert found.smallest == pytest.approx(values[-1], rel=rank.ACCURACY)
    assert found.condition == pytest.approx(values[0] / values[-1], rel=rank.ACCURACY)


@pytest.mark.parametrize("method", [rank._sparse, rank._dense])
def test_dependent_rows_are_counted_and_grouped(method):
    matrix, groups = with_copies(banded(420, 600, 1))
    found = method(matrix)
    assert (found.rows, found.rank, found.nullity) == (423, 420, 3)
    assert np.abs(matrix.T @ found.vectors).max() < NULL
    assert {frozenset(group.rows.tolist()) for group in dependencies(found.vectors)} == {
        frozenset(group) for group in groups
    }
    assert [group.excess for group in dependencies(found.vectors)] == [1, 1, 1]


def test_more_dependent_rows_than_the_first_subspace_holds_are_all_found():
    matrix = banded(430, 900, 2)
    copies = 3 * rank.FIRST_SIZE
    found = rank._sparse(sparse.vstack([matrix, matrix[:copies]], format="csr"))
    assert (found.nullity, found.complete) == (copies, True)
    assert found.rank == 430


def test_more_rows_than_columns_are_too_many_by_the_difference():
    found = rank._sparse(banded(460, 440, 3))
    assert found.nullity >= 20
    assert found.rank == np.linalg.matrix_rank(banded(460, 440, 3).toarray(), tol=1e-8 * found.largest)


def test_small_and_empty_matrices_have_a_spectrum():
    nothing = spectrum(sparse.csr_matrix((0, 5)))
    assert (nothing.rank, nothing.condition) == (0, None)
    ones = spectrum(sparse.csr_matrix(np.ones((3, 2))))
    assert (ones.rank, ones.nullity) == (1, 2)
    zeros = spectrum(sparse.csr_matrix((2, 4)))
    assert (zeros.rank, zeros.nullity, zeros.condition) == (0, 2, None)


def quadratic(n: int, m: int, eigenvalues: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A Hessian (n, n) whose eigenvalues on the null space of rows (m, n) are the given ones (n - m,)."""
    generator = np.random.default_rng(seed)
    basis = linalg.qr(generator.standard_normal((n, n)))[0]
    free, held = basis[:, : n - m], basis[:, n - m :]
    cross = generator.standard_normal((n - m, m))
    hessian = free @ np.diag(eigenvalues) @ free.T - held @ held.T + free @ cross @ held.T
    hessian = (hessian + hessian.T) - (free @ np.diag(eigenvalues) @ free.T - held @ held.T)
    return hessian, generator.standard_normal((m, m)) @ held.T


@pytest.mark.parametrize("method", [curving._dense, None])
@pytest.mark.parametrize(
    ("values", "holds", "negative"),
    [([0.5, 2.0, 3.0], True, False), ([-0.1, 1.0, 2.0], False, True), ([0.0, 1.0, 4.0], False, False)],
)
def test_curvature_of_a_quadratic_problem_is_the_one_it_was_made_with(method, values, holds, negative):
    hessian, rows = quadratic(5, 2, np.array(values), 4)
    if method is None:
        found = curvature(sparse.csr_matrix(hessian), sparse.csr_matrix(rows))
    else:
        found = method(hessian, rows)
    assert found.directions == 3
    assert found.exact
    assert found.values == pytest.approx(np.sort(values), abs=NULL)
    assert (found.holds, found.negative) == (holds, negative)
    assert np.abs(rows @ found.vectors).max() < NULL


@pytest.mark.parametrize("lowest", [1e-3, -1e-3, -0.3])
def test_curvature_by_lanczos_is_that_of_a_dense_decomposition(lowest):
    n, m = 160, 60
    spread = np.concatenate([[lowest], np.geomspace(2e-3, 1.0, n - m - 1)])
    hessian, rows = quadratic(n, m, spread, 5)
    found = curving._sparse(sparse.csc_matrix(hessian), sparse.csc_matrix(rows))
    exact = curving._dense(hessian, rows)
    assert exact.smallest == pytest.approx(lowest, abs=NULL)
    assert found.smallest == pytest.approx(lowest, rel=CURVATURE)
    assert found.largest == pytest.approx(1.0, rel=1e-2)
    assert (found.directions, found.negative) == (n - m, lowest < 0)
    assert np.abs(rows @ found.vectors).max() < NULL
    assert abs(found.vectors[:, 0] @ exact.vectors[:, 0]) == pytest.approx(1.0, abs=1e-3)


def test_no_free_direction_leaves_no_curvature():
    found = curvature(sparse.eye(4), sparse.eye(4))
    assert (found.directions, found.smallest, found.holds) == (0, None, True)


def test_lanczos_finds_both_ends_of_a_spectrum():
    diagonal = np.concatenate([[-5.0], np.linspace(1.0, 2.0, 200), [9.0]])
    vectors = lanczos(lambda p: diagonal * p, np.ones(len(diagonal)))
    quotients = np.einsum("ij,i,ij->j", vectors, diagonal, vectors)
    assert quotients.min() == pytest.approx(-5.0)
    assert quotients.max() == pytest.approx(9.0)
