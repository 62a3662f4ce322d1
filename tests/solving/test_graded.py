"""Solves to a grade: the mesh is refined until the motion holds at any time; the verdict says where not."""

import numpy as np
import pytest

import trajopt
from tests.support.problems import hop, landing, reach
from tests.support.swings import BALL, FAR, past, swing
from trajopt.certify.check import examine
from trajopt.certify.report import GRADE
from trajopt.errors import InputError
from trajopt.solution.grid import mesh_of
from trajopt.solving.graded import first_mesh, solve_graded
from trajopt.solving.remeshing import PhaseErrors, remeshed
from trajopt.transcription.mesh import Mesh

pytestmark = pytest.mark.long


def test_motion_is_refined_until_it_holds_at_any_time():
    found = solve_graded(landing())
    assert found.reached, found.why
    assert found.solution.success
    assert trajopt.check(found.solution).within(GRADE)
    assert found.solution.statistics.graded.reached is True
    sizes = [own.variables for own in found.rounds]
    assert sizes == sorted(sizes)


def test_solve_without_a_mesh_solves_to_the_grade_and_a_draft_only_once():
    draft = trajopt.solve(landing(), draft=True)
    assert len(draft.statistics.graded.rounds) == 1
    assert mesh_of(draft) == first_mesh(landing())
    assert draft.converged
    assert trajopt.solve(landing()).success


def test_named_mesh_is_solved_once():
    plan = trajopt.solve(reach(gravity=True), intervals=4)
    assert plan.n_intervals == 4
    assert len(plan.statistics.graded.rounds) == 1
    own = trajopt.solve(reach(gravity=True), fixed_mesh=True)
    assert own.n_intervals == reach(gravity=True).default_intervals
    with pytest.raises(InputError, match="a draft and a mesh are both asked for"):
        trajopt.solve(reach(), intervals=4, draft=True)


def test_motion_that_holds_only_at_its_points_says_what_breaks_and_where():
    found = solve_graded(landing(), mesh=Mesh.uniform("legendre:1", (3, 3, 3)), max_rounds=1)
    assert not found.reached
    assert found.solution.converged
    assert found.solution.statistics.status == "coarse_grid"
    assert " times what is allowed" in found.solution.statistics.advice
    assert any(name in found.solution.statistics.advice for name in ("flight", "landing"))
    assert found.solution.statistics.failures


def test_limit_of_rounds_ends_with_the_best_motion():
    found = solve_graded(landing(), mesh=Mesh.uniform("legendre:1", (3, 3, 3)), max_rounds=2)
    assert len(found.rounds) == 2
    assert found.why == "2 rounds were not enough" or found.reached


def test_examination_compares_intervals_with_their_tolerances():
    plan = trajopt.solve(hop(), intervals=8)
    found = examine(plan)
    assert found.broken.shape == (plan.n_intervals,)
    assert found.drift.shape == (len(plan.phases),)
    judged = [name for name in found.report.failures() if name.endswith("_between")]
    assert bool(judged) == bool((found.broken > 1).any()) or "penetration" in found.report.failures()


def test_only_broken_intervals_are_split_where_phases_are_accurate():
    mesh = Mesh.uniform("legendre:4", (2, 3))
    accurate = [PhaseErrors(local=np.full(n, 1e-9), phase=0.1, unknowns=(10, 20)) for n in (2, 3)]
    broken = np.array([0.5, 0.9, 0.0, 3.0, 100.0])
    assert remeshed(mesh, accurate, broken, 1.0).counts == (2, 1 + 2 + 4)
    assert remeshed(mesh, accurate, 0 * broken, 1.0) == mesh


def test_a_start_brings_its_mesh_and_the_rows_of_its_bodies(tmp_path):
    problem = past(swing(), BALL, FAR)
    first = solve_graded(problem)
    assert first.reached
    assert len(first.rounds) > 1
    again = solve_graded(problem, start=first.solution.save(tmp_path / "past.npz"))
    assert again.reached
    (only,) = again.rounds
    assert only.mesh == first.rounds[-1].mesh
    assert 3 * only.iterations < sum(each.iterations for each in first.rounds)
    assert again.solution.statistics.objective == pytest.approx(first.solution.statistics.objective, rel=1e-3)
