"""A diagnosis calls clean problems clean, and names what is wrong with the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import linprog

import trajopt
from tests.support.problems import REACH, REACH_TIME, hop, lean, one_joint_arm, reach
from tests.support.redundant_contacts import corners, solo_hop
from trajopt import Problem, Robot, Solution
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.solving.extraction import extract
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.study.diagnosis.conflict import BOX
from trajopt.study.diagnosis.contacts import _rank
from trajopt.study.diagnosis.diagnose import diagnose
from trajopt.study.diagnosis.diagnosis import Diagnosis
from trajopt.study.diagnosis.snapshot import Snapshot
from trajopt.terms import (
    AccelerationCost,
    Context,
    EffortLimits,
    PointConstraint,
    PositionLimits,
    Rows,
    TerminalState,
    TorqueCost,
)
from trajopt.transcription import term_functions
from trajopt_library import problems

# Values of rows against the samples of the solution, relative to their unit.
SAME = 1e-9
# A torque this close to its limit is at it, part of the limit.
AT_LIMIT = 1e-4


@lru_cache
def solved(name: str) -> tuple[Problem, Solution]:
    problem = {"reach": reach, "lean": lean, "hop": hop, "solo": solo_hop}[name]()
    intervals = {"hop": 8, "solo": 9}.get(name)
    return problem, trajopt.solve(problem, intervals=intervals, compile="none")


@lru_cache
def diagnosed(name: str) -> Diagnosis:
    return diagnose(solved(name)[1], solved(name)[0])


def keep_all_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcriptions without the elimination of redundant rows."""

    def every(robot: Robot, q: object, before: tuple, after: tuple, places: object = None) -> dict:
        return {contact.name: contact.rows for contact in (*before, *after)}

    monkeypatch.setattr(term_functions, "independent_rows", every)


def inertia() -> float:
    model = one_joint_arm().model
    return float(model.inertias[1].matrix()[4, 4] + model.armature[0])


def limited_reach(torque: float) -> Problem:
    return reach(terms=(AccelerationCost(weight=1.0), EffortLimits(limit=np.array([torque]))))


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


# Names


def snapshot_of(problem: Problem, solution: Solution) -> Snapshot:
    from trajopt.solution.grid import mesh_of
    from trajopt.study.diagnosis.sources import at_solution

    return at_solution(prepare(problem, mesh=mesh_of(solution), compile="none"), solution)


def test_a_solutions_own_unknowns_and_multipliers_are_stationary():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    assert snapshot.stationarity is not None
    assert snapshot.stationarity < 1e-5
    assert snapshot.complementarity < 1e-5
    assert snapshot.violations.max() < 1e-6


def test_an_unknown_changes_what_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    transcription, names = snapshot.transcription, snapshot.names
    model, before = problem.robot.model, extract(transcription, snapshot.x, {"success": True})
    seen = set()
    for index in range(0, len(snapshot.x), 7):
        label, site = names.unknown_labels[index], names.unknown_sites[index]
        if label.owner in ("base", "") or label.kind == "clock":
            continue
        moved = snapshot.x.copy()
        moved[index] += 0.1
        after = extract(transcription, moved, {"success": True})
        arrays = {"position": "q", "rate": "v", "acceleration": "a", "force": "f"}
        array = arrays[label.kind]
        changed = np.abs(getattr(after, array) - getattr(before, array)).reshape(len(before.t), -1) > 1e-6
        at = np.abs(before.t - names.time(site)) < 1e-9
        if label.kind == "force":
            column = {"x": 0, "y": 1, "z": 2}[label.quantity[-1]]
        else:
            joint = model.joints[model.getJointId(label.owner)]
            column = joint.idx_q if label.kind == "position" else joint.idx_v
        assert changed[at][:, column].any(), names.unknown(index)
        others = np.delete(changed[at & before.collocation], column, axis=1)
        if site.point >= 0:
            assert not others.any(), names.unknown(index)
        seen.add(label.kind)
    assert seen == {"position", "rate", "acceleration", "force"}


def test_a_row_of_a_limit_is_the_torque_that_its_name_says():
    problem, solution = solved("hop")
    snapshot = snapshot_of(problem, solution)
    names, unit = snapshot.names, Units(problem.robot).torque
    rows = [row for row in range(len(snapshot.g)) if names.block(row) == "effort_limits"]
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
    texts = {names.row(row).what for row in range(len(names.row_sites))}
    assert "contact_acceleration [foot acceleration y]" in texts
    assert "base_dynamics [base turn about x balance]" in texts
    assert "contact_landing [foot position z]" in texts
    assert "frame_height [foot position z]" in texts
    assert "defect [hip rate]" in texts
    assert "velocity_limits [shank rate]" in texts


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("hopper-hop", {"touchdown": "impact"}, {"jump", "impulse", "force"}),
        ("hopper-hop", {"coordinates": "minimal"}, {"position", "rate", "acceleration"}),
        ("hopper-hop", {"goal": "time"}, {"clock"}),
        ("hopper-gait", {}, {"position", "rate"}),
        ("ur5-reach", {"actuation": "velocity"}, {"position", "rate"}),
        ("arm-pick-place", {}, {"position"}),
    ],
)
def test_every_unknown_and_row_has_a_name(name, values, expected):
    prepared = prepare(problems.load(name, **values), intervals=8, compile="none")
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
    solution = trajopt.solve(problem)
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
    return snapshot.names.phase(snapshot.names.row_sites[row].stage)


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
    terms = (TorqueCost(weight=1.0), AccelerationCost(weight=1e-2))
    return hop("surface", robot=robot, schedule=stance, terms=terms, default_intervals=3)


@pytest.mark.parametrize(("count", "excess"), [(2, 1), (4, 6)])
def test_points_of_one_body_are_found_where_their_rows_are_all_kept(monkeypatch, count, excess):
    """Two points on a line hold each other along it; four corners have twelve rows of rank six."""
    keep_all_rows(monkeypatch)
    prepared = prepare(corner_stance(count), compile="none")
    found = diagnose(prepared)
    assert found.status is None
    at_a_point = [group for group in found.dependent if set(group.blocks) == {"contact_acceleration"}]
    assert sum(group.excess for group in at_a_point) == 2 * 3 * excess
    named = {row for group in at_a_point for row in group.rows}
    assert {f"contact_acceleration [corner{i} acceleration y]" for i in range(count)} <= named


def test_forces_that_no_cost_tells_apart_have_no_curvature():
    found = diagnose(prepare(corner_stance(4), compile="none"))
    assert found.contacts[0].redundant
    assert found.curvature is not None
    assert not found.curvature.holds
    assert "force" in found.curvature.flat_along[0].kinds[0]
    assert any("WrenchCost" in advice.remedy for advice in found.advice)


def test_a_goal_that_is_stated_twice_is_named():
    problem = reach()
    goal = TerminalState(q=np.array([REACH]))
    twice = replace(problem, terms=(*problem.terms, goal))
    found = diagnose(prepare(twice, compile="none"))
    (group,) = found.dependent
    assert group.excess == 1
    assert set(group.rows) == {"terminal_state [joint position (1)]", "terminal_state [joint position (2)]"}
    assert any("repeat" in advice.remedy for advice in found.advice)


# Limits and conflicts


def test_active_limits_are_those_that_the_torques_of_the_solution_reach():
    """With the least acceleration the torque falls linearly from its largest value: cut off at 0.8 of it."""
    limit = 0.8 * 6 * REACH / REACH_TIME**2 * inertia()
    problem = limited_reach(limit)
    solution = trajopt.solve(problem, compile="none")
    found = diagnose(solution, problem)
    tau = solution.tau[solution.collocation, 0]
    sides = {active.side: active for active in found.limits if active.block == "effort_limits"}
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
    solution = trajopt.solve(problem, compile="none")
    assert not solution.success
    found = diagnose(solution, problem)
    assert found.conflict is not None
    assert found.conflict.stuck
    assert found.conflict.giving[0].what.startswith("terminal_")
    assert found.conflict.against[0].what == "effort_limits [joint torque]"
    assert found.conflict.after == pytest.approx(least_violation(snapshot_of(problem, solution)), rel=1e-3)
    reached = next(advice for advice in found.advice if "out of reach" in advice.finding)
    assert "lengthen the phase, raise the effort limit" in reached.remedy
    assert found.worst[0].block.startswith(("terminal_", "defect"))


def test_an_iterate_that_is_only_early_is_not_called_a_conflict():
    problem = hop()
    solution = trajopt.solve(problem, compile="none", max_iterations=2)
    found = diagnose(solution, problem)
    assert found.status == "iteration_limit"
    assert found.conflict is not None
    assert not found.conflict.stuck
    assert any("early" in advice.remedy for advice in found.advice)
    assert all(report.equations for report in found.ranks)


def test_a_problem_without_a_cost_has_directions_without_curvature():
    found = diagnose(prepare(reach(terms=()), compile="none"))
    assert found.curvature is not None
    assert not found.curvature.holds
    assert "joint acceleration" in found.curvature.smallest_along[0].unknowns[0]
    assert any("AccelerationCost" in advice.remedy for advice in found.advice)


@dataclass(frozen=True, kw_only=True)
class Badly(PointConstraint):
    """A limit of the joint's rate, in rad/s, over a unit of a millionth."""

    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(context.dxi[0], -1e3, 1e3, 1e-6)


def test_rows_over_a_wrong_unit_are_told():
    problem = reach(terms=(AccelerationCost(weight=1.0), Badly()))
    found = diagnose(prepare(problem, compile="none"))
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
    start = diagnose(prepare(replace(problem, initial_q=q), compile="none")).start
    assert start == (f"the start has shank exactly on its upper limit {q[-1]:.4g}",)
    without = tuple(term for term in problem.terms if not isinstance(term, PositionLimits))
    assert diagnose(prepare(replace(problem, initial_q=q, terms=without), compile="none")).start == ()


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
    problem = reach(gravity=True, terms=(TorqueCost(weight=1.0),))
    solution = trajopt.solve(problem, transcription="semi-implicit-euler", intervals=4, compile="none")
    found = diagnose(solution, problem)
    assert found.local_error is not None
    assert found.local_error["reach"] > 1e-3
    assert any("too coarse" in advice.remedy for advice in found.advice)


def test_a_guess_is_diagnosed_without_a_solve():
    prepared: PreparedProblem = prepare(hop(), compile="none")
    found = diagnose(prepared)
    assert found.status is None
    assert found.nonfinite is None
    assert "guess of hop" in str(found)


def test_bad_input_is_refused_in_one_line():
    _, solution = solved("reach")
    with pytest.raises(InputError, match="'reach' is not in the catalogue"):
        diagnose(solution)
    with pytest.raises(InputError, match="other joints"):
        diagnose(solution, lean())
    with pytest.raises(InputError, match="3 is no solution"):
        diagnose(3)  # type: ignore[arg-type]


def test_a_file_of_another_problem_is_told_apart():
    _, solution = solved("reach")
    other = reach(terms=(AccelerationCost(weight=3.0),))
    assert any("objective" in note for note in diagnose(solution, other).notes)
