"""A diagnosis calls clean problems clean, and names what is wrong with the others."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import linprog

import trajopt
from tests.support.diagnosed import snapshot_of, solved
from tests.support.problems import FOOT, REACH, REACH_TIME, hop, inertia, lean, limited_reach, reach
from tests.support.redundant_contacts import corners
from trajopt import InputError, Problem, Robot, diagnose, terms
from trajopt.robot import Units, contact_positions
from trajopt.solving.diagnosis.conflict import BOX
from trajopt.solving.diagnosis.contacts import _rank
from trajopt.solving.diagnosis.diagnosis import Diagnosis
from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.transcription import term_functions

pytestmark = pytest.mark.long

# A torque this close to its limit is at it, part of the limit.
AT_LIMIT = 1e-4


@lru_cache
def diagnosed(name: str) -> Diagnosis:
    return diagnose(solved(name)[1], solved(name)[0])


def keep_all_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcriptions without the elimination of redundant rows."""

    def every(robot: Robot, q: object, before: tuple, after: tuple, *_: object) -> dict:
        return {contact.name: contact.rows for contact in (*before, *after)}

    monkeypatch.setattr(term_functions, "independent_rows", every)


# Clean problems


@pytest.mark.parametrize("name", ["reach", "lean"])
def test_a_solved_problem_with_full_rank_and_curvature_is_clean(name):
    found = diagnosed(name)
    assert found.solved
    assert found.clean, [str(advice) for advice in found.advice]
    assert all(report.full for report in found.ranks)
    assert found.curvature is not None
    assert found.curvature.holds
    assert found.notes == ()
    assert "nothing" in str(found).splitlines()[-1]


def test_the_rank_of_all_rows_is_that_of_a_dense_decomposition():
    problem, solution = solved("hop")
    found = diagnosed("hop")
    snapshot = snapshot_of(problem, solution)
    matrix = snapshot.jacobian[snapshot.active_rows][:, snapshot.free].toarray()
    values = np.linalg.svd(matrix, compute_uv=False)
    assert found.ranks[0].rank == np.linalg.matrix_rank(matrix)
    assert found.ranks[0].condition == pytest.approx(values[0] / values[-1], rel=1e-3)
    assert [report.phase for report in found.ranks[1:]] == ["stance", "flight", "landing"]
    assert sum(report.rows for report in found.ranks[1:]) == found.ranks[0].rows


# Dependent rows


def test_four_coplanar_feet_are_found_where_their_rows_are_all_kept(monkeypatch):
    problem, solution = solved("solo")
    keep_all_rows(monkeypatch)
    found = diagnose(solution, problem)
    stance = next(report for report in found.ranks if report.phase == "stance")
    points = 2 * int(np.sum(solution.phase[~solution.collocation] == 0) / 2)
    assert stance.nullity == 2 * points
    groups = {group.rows: group for group in stance.dependent}
    for pair in (("FL", "FR"), ("HL", "HR")):
        rows = tuple(f"contact_acceleration [{leg}_FOOT acceleration y]" for leg in pair)
        assert groups[rows].excess == points
        assert groups[rows].times == points
    assert any("contacts fix each other" in advice.remedy for advice in found.advice)
    assert any("without" in note for note in found.notes)


def test_the_contacts_report_says_what_the_transcription_left_out():
    found = diagnosed("solo")
    assert all(report.full for report in found.ranks)
    stance = found.contacts[0]
    assert (stance.rows, stance.least, stance.most) == (12, 10, 10)
    assert stance.redundant
    assert not stance.singular
    assert {group.rows for group in stance.dependencies} == {
        ("FL_FOOT y", "FR_FOOT y"), ("HL_FOOT y", "HR_FOOT y")
    }  # fmt: skip
    assert stance.left_out == ("FR_FOOT y", "HR_FOOT y")


def corner_stance(count: int) -> Problem:
    """The hopper with a foot of so many corners, standing for a moment."""
    robot = corners()
    robot = replace(robot, contacts=robot.contacts[:count])
    names = tuple(contact.name for contact in robot.contacts)
    stance = trajopt.Schedule((trajopt.Phase(name="stance", duration=0.2, contacts=names),))
    all_terms = (terms.TorqueCost(weight=1.0), terms.AccelerationCost(weight=1e-2))
    return hop("surface", robot=robot, schedule=stance, terms=all_terms, default_intervals=3)


@pytest.mark.parametrize(("count", "excess"), [(2, 1), (4, 6)])
def test_points_of_one_body_are_found_where_their_rows_are_all_kept(monkeypatch, count, excess):
    """Two points on a line hold each other along it; four corners have twelve rows of rank six."""
    keep_all_rows(monkeypatch)
    prepared = prepare(corner_stance(count))
    found = diagnose(prepared)
    assert found.status is None
    at_a_point = [group for group in found.dependent if set(group.blocks) == {"contact_acceleration"}]
    assert sum(group.excess for group in at_a_point) == 2 * 3 * excess
    named = {row for group in at_a_point for row in group.rows}
    assert {f"contact_acceleration [corner{i} acceleration y]" for i in range(count)} <= named


def test_forces_that_no_cost_tells_apart_have_no_curvature():
    found = diagnose(prepare(corner_stance(4)))
    assert found.contacts[0].redundant
    assert found.curvature is not None
    assert not found.curvature.holds
    assert "force" in found.curvature.flat_along[0].kinds[0]
    assert any("WrenchCost" in advice.remedy for advice in found.advice)


def test_a_goal_that_is_stated_twice_is_named():
    problem = reach()
    goal = terms.TerminalState(q=np.array([REACH]))
    twice = replace(problem, terms=(*problem.terms, goal))
    found = diagnose(prepare(twice))
    (group,) = found.dependent
    assert group.excess == 1
    assert set(group.rows) == {"terminal_state [joint position (1)]", "terminal_state [joint position (2)]"}
    assert any("repeat" in advice.remedy for advice in found.advice)


# Limits and conflicts


def test_active_limits_are_those_that_the_torques_of_the_solution_reach():
    """With the least acceleration the torque falls linearly from its largest value: cut off at 0.8 of it."""
    limit = 0.8 * 6 * REACH / REACH_TIME**2 * inertia()
    problem = limited_reach(limit)
    solution = trajopt.solve(problem, fixed_mesh=True)
    found = diagnose(solution, problem)
    tau = solution.tau[solution.collocation, 0]
    sides = {active.side: active for active in found.limits if active.block == "torque_limits"}
    for side, at in (("upper", tau > limit * (1 - AT_LIMIT)), ("lower", tau < -limit * (1 - AT_LIMIT))):
        active = sides[side]
        assert at.any()
        assert active.places == active.strict == at.sum()
        assert active.of == len(tau)
        assert active.about == "joint torque"
        assert active.duration == pytest.approx(at.sum() * REACH_TIME / len(tau))
        assert not active.weak
    assert sides["upper"].last < REACH_TIME / 2 < sides["lower"].first


def least_violation(snapshot: Snapshot) -> float:
    """Least sum of violations of the linearised rows, the motion itself kept, by HiGHS."""
    transcription = snapshot.transcription
    moves = ~snapshot.fixed
    jacobian = snapshot.jacobian[:, moves].toarray()
    motion = np.array([snapshot.names.block(row) == "defect" for row in range(len(jacobian))])
    low, high = transcription.lower_g - snapshot.g, transcription.upper_g - snapshot.g
    slack = np.eye(len(jacobian))[:, ~motion]
    sides = np.vstack([np.hstack([jacobian, slack, -slack]), np.hstack([-jacobian, -slack, slack])])
    found = linprog(
        np.concatenate([np.zeros(jacobian.shape[1]), np.ones(2 * slack.shape[1])]),
        A_ub=sides[np.isfinite([*high, *-low])],
        b_ub=np.array([*high, *-low])[np.isfinite([*high, *-low])],
        bounds=[(-BOX, BOX)] * jacobian.shape[1] + [(0, None)] * (2 * slack.shape[1]),
    )
    return float(found.fun)


def test_a_goal_that_torques_do_not_reach_is_named_with_them():
    """The least torque that gets there in time switches once: 4 I angle / T^2. Here is half of it."""
    problem = limited_reach(0.5 * 4 * REACH / REACH_TIME**2 * inertia())
    solution = trajopt.solve(problem, fixed_mesh=True)
    assert not solution.success
    found = diagnose(solution, problem)
    assert found.conflict is not None
    assert found.conflict.is_conflict
    assert found.conflict.giving[0].what.startswith("terminal_")
    assert found.conflict.against[0].what == "torque_limits [joint torque]"
    assert found.conflict.after == pytest.approx(least_violation(snapshot_of(problem, solution)), rel=1e-3)
    reached = next(advice for advice in found.advice if "out of reach" in advice.finding)
    assert "lengthen the phase, raise the torque limit" in reached.remedy
    assert found.worst[0].block.startswith(("terminal_", "defect"))


def test_an_iterate_that_is_only_early_is_not_called_a_conflict():
    problem = hop()
    solution = trajopt.solve(problem, max_iterations=2, fixed_mesh=True)
    found = diagnose(solution, problem)
    assert found.status == "iteration_limit"
    assert found.conflict is not None
    assert not found.conflict.is_conflict
    assert any("early" in advice.remedy for advice in found.advice)
    assert all(report.equations for report in found.ranks)


def test_a_problem_without_a_cost_has_directions_without_curvature():
    found = diagnose(prepare(reach(terms=())))
    assert found.curvature is not None
    assert not found.curvature.holds
    assert "joint acceleration" in found.curvature.smallest_along[0].unknowns[0]
    assert any("AccelerationCost" in advice.remedy for advice in found.advice)


@dataclass(frozen=True, kw_only=True)
class Badly(terms.PointConstraint):
    """A limit of the joint's rate, in rad/s, over a unit of a millionth."""

    def rows(self, context: terms.Context, units: Units) -> terms.Rows:
        return terms.Rows.create(context.dxi[0], -1e3, 1e3, 1e-6)


def test_rows_over_a_wrong_unit_are_told():
    problem = reach(terms=(terms.AccelerationCost(weight=1.0), Badly()))
    found = diagnose(prepare(problem))
    assert found.scaling is not None
    (block,) = found.scaling.worst_blocks
    assert block.block == "badly"
    assert block.row_norm.largest > 1e5
    assert any("badly is far from scale one" in advice.finding for advice in found.advice)


def test_a_start_on_a_limit_is_told():
    problem = hop()
    robot = problem.robot
    q = robot.reference.copy()
    q[-1] = robot.position_upper[-1]
    q[2] -= contact_positions(robot, q)[FOOT][2]
    start = diagnose(prepare(replace(problem, initial_q=q))).start
    assert start == (f"the start has shank exactly on its upper limit {q[-1]:.4g}",)
    without = tuple(term for term in problem.terms if not isinstance(term, terms.PositionLimits))
    assert diagnose(prepare(replace(problem, initial_q=q, terms=without))).start == ()


def test_contact_ranks_fall_where_legs_are_straight():
    problem, _ = solved("solo")
    robot = problem.robot
    straight = robot.reference.copy()
    straight[7:] = 0.0
    bent, singular = (_rank(robot.model, robot.contacts, q) for q in (robot.reference, straight))
    assert bent is not None
    assert singular is not None
    assert singular.delassus < bent.delassus


# What is given


def test_a_mesh_that_is_too_coarse_is_named_with_its_phase():
    problem = reach(gravity=True, terms=(terms.TorqueCost(weight=1.0),))
    solution = trajopt.solve(problem, transcription="semi-implicit-euler", intervals=4)
    found = diagnose(solution, problem)
    assert found.local_error is not None
    assert found.local_error["reach"] > 1e-3
    assert any("too coarse" in advice.remedy for advice in found.advice)


def test_a_guess_is_diagnosed_without_a_solve():
    prepared: PreparedProblem = prepare(hop())
    found = diagnose(prepared)
    assert found.status is None
    assert found.nonfinite is None
    assert "guess of hop" in str(found)


def test_bad_input_is_refused_in_one_line():
    _, solution = solved("reach")
    with pytest.raises(InputError, match="'reach' is not in the catalogue"):
        diagnose(solution)
    with pytest.raises(InputError, match=r"is on robot .hopper., and solution on .arm."):
        diagnose(solution, lean())
    with pytest.raises(InputError, match="what of diagnose is 3"):
        diagnose(3)  # type: ignore[arg-type]


def test_a_file_of_another_problem_is_told_apart():
    _, solution = solved("reach")
    other = reach(terms=(terms.AccelerationCost(weight=3.0),))
    assert any("objective" in note for note in diagnose(solution, other).notes)
