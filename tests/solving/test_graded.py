"""Solves to a grade: the mesh is refined until the motion holds at any time; the verdict says where not."""

import numpy as np
import pytest

import trajopt
from tests.support.problems import REACH, REACH_TIME, hop, inertia, landing, limited_reach, reach
from tests.support.swings import BALL, FAR, past, swing
from trajopt import InputError, Problem
from trajopt.certify.check import examine
from trajopt.certify.report import GRADE
from trajopt.motion.grid import mesh_of
from trajopt.solving import solve_graded, solve_within
from trajopt.solving.graded import first_mesh
from trajopt.solving.remeshing import PhaseErrors, remeshed
from trajopt.solving.solving import solve
from trajopt.solving.stalling import CERTIFIED
from trajopt.transcription.mesh import Mesh
from trajopt_library import problems


@pytest.mark.long
def test_motion_is_refined_until_it_holds_at_any_time():
    found = solve_graded(landing())
    assert found.reached, found.why
    assert found.solution.success
    assert trajopt.check(found.solution).within(GRADE)
    assert found.solution.statistics.graded.reached is True
    sizes = [own.variables for own in found.rounds]
    assert sizes == sorted(sizes)


@pytest.mark.long
def test_solve_without_a_mesh_solves_to_the_grade_and_a_draft_only_once():
    draft = trajopt.solve(landing(), draft=True)
    assert len(draft.statistics.graded.rounds) == 1
    assert mesh_of(draft) == first_mesh(landing())
    assert draft.converged
    assert trajopt.solve(landing()).success


@pytest.mark.long
def test_named_mesh_is_solved_once():
    plan = trajopt.solve(reach(gravity=True), intervals=4)
    assert plan.n_intervals == 4
    assert len(plan.statistics.graded.rounds) == 1
    own = trajopt.solve(reach(gravity=True), fixed_mesh=True)
    assert own.n_intervals == reach(gravity=True).default_intervals
    with pytest.raises(InputError, match="a draft and a mesh are both asked for"):
        trajopt.solve(reach(), intervals=4, draft=True)


@pytest.mark.long
def test_motion_that_holds_only_at_its_points_says_what_breaks_and_where():
    found = solve_graded(landing(), mesh=Mesh.uniform("legendre:1", (3, 3, 3)), max_rounds=1)
    assert not found.reached
    assert found.solution.converged
    assert found.solution.statistics.status == "coarse_grid"
    assert " times what is allowed" in found.solution.statistics.advice
    assert any(name in found.solution.statistics.advice for name in ("flight", "landing"))
    assert found.solution.statistics.failures


@pytest.mark.long
def test_limit_of_rounds_ends_with_the_best_motion():
    found = solve_graded(landing(), mesh=Mesh.uniform("legendre:1", (3, 3, 3)), max_rounds=2)
    assert len(found.rounds) == 2
    assert found.why == "2 rounds were not enough" or found.reached


@pytest.mark.long
def test_examination_compares_intervals_with_their_tolerances():
    plan = trajopt.solve(hop(), intervals=8)
    found = examine(plan)
    assert found.broken.shape == (plan.n_intervals,)
    assert found.drift.shape == (len(plan.phases),)
    judged = [name for name in found.report.failures() if name.endswith("_between")]
    assert bool(judged) == bool((found.broken > 1).any()) or "penetration" in found.report.failures()


@pytest.mark.long
def test_only_broken_intervals_are_split_where_phases_are_accurate():
    mesh = Mesh.uniform("legendre:4", (2, 3))
    accurate = [PhaseErrors(local=np.full(n, 1e-9), phase=0.1, unknowns=(10, 20)) for n in (2, 3)]
    broken = np.array([0.5, 0.9, 0.0, 3.0, 100.0])
    assert remeshed(mesh, accurate, broken, 1.0).counts == (2, 1 + 2 + 4)
    assert remeshed(mesh, accurate, 0 * broken, 1.0) == mesh


@pytest.mark.long
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


@pytest.mark.long
def test_a_long_time_is_used_for_a_finer_mesh_than_the_grade_needs():
    graded, within = solve_graded(reach()), solve_within(reach(), 60.0)
    assert within.reached
    assert within.solution.statistics.graded.error_m == within.error
    assert len(within.rounds) > len(graded.rounds)
    errors = [max(one.errors) for one in within.rounds if one.errors is not None]
    assert within.error == min(errors)


def test_a_time_that_is_too_short_for_a_first_solve_ends_as_a_time_limit():
    within = solve_within(hop(), 1e-6)
    assert not within.reached
    assert within.solution.statistics.status == "time_limit"


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan"), True])
def test_a_time_that_is_none_is_refused(budget: float):
    with pytest.raises(InputError, match="budget"):
        solve_within(reach(), budget)


def test_what_is_not_solved_is_not_refined():
    within = solve_within(hop(), 60.0, max_iterations=1)
    assert not within.solution.converged
    assert within.accuracy is None


# With half of the least torque, see `limited_reach`.
TOO_WEAK = 0.5 * 4 * inertia() * REACH / REACH_TIME**2
# Iterations of a certificate of such small problems; IPOPT alone takes hundreds or ends without one.
FEW = 80
# Flight in s near the longest that any start solves on the hopper's mesh: IPOPT alone takes 50 to 210
# iterations, with violations that stay for long.
SLOW = 1.3


def weak() -> Problem:
    return limited_reach(TOO_WEAK)


def hopping(**values: object) -> Problem:
    return problems.load("hopper-hop", **values)


def test_goal_that_torques_do_not_reach_is_certified_with_both_by_name_and_place():
    statistics = solve(weak()).statistics
    assert statistics.status == "infeasible"
    assert statistics.solver_status == CERTIFIED
    assert statistics.certified_infeasible is True
    assert not statistics.success
    assert statistics.iterations <= FEW
    assert statistics.max_violation > 0
    for words in ("terminal_", "torque_limits [joint torque]", "t = ", "phase 'reach'", ", against "):
        assert words in statistics.advice
    assert len(statistics.advice.splitlines()) == 3


@pytest.mark.long
def test_hop_without_the_friction_for_it_is_certified():
    statistics = solve(hopping(distance=0.6, friction=0.05)).statistics
    assert statistics.solver_status == CERTIFIED
    assert statistics.iterations <= FEW
    assert "friction_pyramid [foot force" in statistics.advice


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slow_but_feasible_solves_are_not_given_up(seed):
    found = solve(hopping(flight=SLOW), seed=seed, perturb=0.1)
    assert found.converged, found.statistics.advice


@pytest.mark.long
def test_limit_of_iterations_counts_those_of_the_elastic_problem():
    full = solve(weak()).statistics.iterations
    for limit in range(8, full, 6):
        statistics = solve(weak(), max_iterations=limit).statistics
        assert statistics.iterations <= limit
        assert statistics.status == "iteration_limit"


def test_time_limit_holds():
    statistics = solve(weak(), max_time=1e-3).statistics
    assert statistics.status == "time_limit"


@pytest.mark.long
def test_stop_during_the_elastic_problem_is_an_interrupt():
    seen: list[float] = []
    full = solve(weak(), progress=lambda figures: seen.append(figures["restoration"]) or True)
    assert full.statistics.solver_status == CERTIFIED
    inside = len(seen) - 3  # of the elastic problem, which comes last
    calls = iter(range(len(seen)))
    stopped = solve(weak(), progress=lambda _: next(calls) < inside)
    assert stopped.statistics.status == "interrupted"
    assert not stopped.statistics.certified_infeasible


def test_iterations_are_told_in_order_with_the_iterates_of_the_problem():
    numbers: list[float] = []
    sizes: set[int] = set()

    def look(iterate):
        if iterate.stage == "iteration":
            numbers.append(iterate.figures["iteration"])
            sizes.add(iterate.unknowns.size)

    found = solve(weak(), watch=look)
    assert numbers == sorted(numbers)
    assert sizes == {found.statistics.variables}
