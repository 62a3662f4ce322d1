"""Pruned problems against full ones: joints, contacts, rows and torques that nothing needs."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import reach
from tests.support.scene_optima import SAME_MOTION, SAME_OPTIMUM, objective, solved
from tests.support.scenes import FEET, biped, push, usual
from trajopt import Contact, InputError, Phase, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.reduced.scenes.smallest_scene import smallest
from trajopt.robot.units import Units
from trajopt.schedule import middle_of
from trajopt.terms import (
    AccelerationCost,
    Context,
    FrameHeight,
    PointConstraint,
    PostureCost,
    Rows,
    TorqueCost,
    TorqueLimits,
)
from trajopt.terrain.surface import Surface
from trajopt_library import problems

pytestmark = pytest.mark.long

ARMS = ("left_arm", "right_arm")


@dataclass(frozen=True, kw_only=True)
class Hold(PointConstraint):
    """Some joints do not accelerate: from rest, they stay. Its rows are the coordinates' own."""

    joints: tuple[str, ...]

    def rows(self, context: Context, units: Units) -> Rows:
        model = context.robot.model
        held = [context.ddxi[model.joints[model.getJointId(name)].idx_v] for name in self.joints]
        return Rows.create(ca.vertcat(*held), 0, 0, 1.0)


# What nothing needs


def test_arms_without_a_task_are_locked_and_reported_as_a_choice() -> None:
    made = smallest(push(biped()), plane=False)
    assert made.problem.robot.nv == 12
    (choice,) = made.report.of_kind("choice")
    assert "left_arm, right_arm" in choice.what
    assert choice.saved.variables == made.report.before.variables - made.report.after.variables > 0
    assert choice.saved.rows == made.report.before.rows - made.report.after.rows > 0
    assert not made.report.is_exact


def test_sizes_in_the_report_are_those_of_the_solved_problems() -> None:
    problem = push(biped())
    made = smallest(problem)
    for size, entry in ((made.report.before, problem), (made.report.after, made.problem)):
        found = solved(entry).meta
        assert (size.variables, size.rows) == (found["variables"], found["constraints"])


def test_locked_joints_give_the_optimum_of_the_full_problem_that_holds_them() -> None:
    robot = biped(waist=True)
    terms = [term for term in usual(robot) if not isinstance(term, TorqueCost)]
    above = (*ARMS, "waist_yaw", "waist_pitch")
    problem = push(robot, terms=terms)
    made = smallest(problem, plane=False)
    assert set(made.problem.robot.model.names) == set(robot.model.names) - set(above)
    held = solved(replace(problem, terms=(*terms, Hold(joints=above))))
    own = solved(made.problem)
    assert objective(own) == pytest.approx(objective(held), rel=SAME_OPTIMUM)
    assert_allclose(made.lift(own).q, held.q, atol=SAME_MOTION)


def test_a_lifted_solution_holds_its_locked_joints_and_passes_the_check() -> None:
    made = smallest(push(biped(waist=True)))
    lifted = made.lift(solved(made.problem, 20))
    report = trajopt.check(lifted)
    assert report.within(AT_POINTS), report.failures(AT_POINTS)
    model = lifted.model
    for name in ARMS:
        joint = model.joints[model.getJointId(name)]
        assert np.abs(lifted.v[:, joint.idx_v]).max() == 0
        assert np.abs(lifted.tau[:, joint.idx_v - 6]).max() > 0


def test_kept_joints_move_and_the_report_says_why() -> None:
    made = smallest(push(biped(waist=True)), keep=["left_arm"], plane=False)
    names = set(made.problem.robot.model.names)
    assert "left_arm" in names
    assert "right_arm" not in names
    # The arm hangs on the waist, which nothing needs all the same.
    assert "waist_pitch" not in names
    assert any("left_arm, as asked" in decision.what for decision in made.report.of_kind("kept"))


def test_a_joint_is_needed_by_its_goal_its_posture_its_speed_or_a_term_about_it() -> None:
    robot = biped()
    joint = robot.model.joints[robot.model.getJointId("left_arm")]
    raised, moving = robot.reference.copy(), np.zeros(robot.nv)
    raised[joint.idx_q : joint.idx_q + 2] = [np.cos(0.5), np.sin(0.5)]
    moving[joint.idx_v] = 0.1
    for changes in (
        {"terms": (*usual(robot), PostureCost(weight=1.0, q=raised))},
        {"initial_v": moving},
        {"terms": (*usual(robot), Hold(joints=("left_arm",)))},
        {"terms": (*usual(robot), FrameHeight(frame="left_arm", height=0.0, at=middle_of("stance")))},
    ):
        names = list(smallest(push(robot, **changes), plane=False).problem.robot.model.names)
        assert "left_arm" in names
        assert "right_arm" not in names


def test_joints_to_lock_may_be_named_and_must_exist_and_be_free() -> None:
    problem = push(biped())
    made = smallest(problem, lock=["left_abduction", "right_abduction"], plane=False)
    assert made.problem.robot.nv == 10
    for lock, keep, word in (
        (["tail"], [], "unknown"),
        (["base"], [], "is the base"),
        (["left_hip"], ["left_hip"], "kept as well"),
    ):
        with pytest.raises(InputError, match=word):
            smallest(problem, lock=lock, keep=keep)
    with pytest.raises(InputError, match="joint 'tail' to keep is unknown"):
        smallest(problem, keep=["tail"])
    with pytest.raises(InputError, match=r"plane of smallest is .*; allowed: auto, True, False"):
        smallest(problem, plane="yes")  # type: ignore[arg-type]


def test_arrays_over_joints_follow_the_joints_that_are_left() -> None:
    robot = biped()
    limit = np.arange(1.0, robot.nu + 1)
    terms = (*usual(robot), TorqueLimits(limit=limit))
    made = smallest(push(robot, terms=terms), plane=False)
    own = next(t for t in made.problem.terms if isinstance(t, TorqueLimits) and t.limit is not None)
    assert_allclose(own.limit, limit[:6])
    assert made.problem.guess(0.0).shape == made.problem.initial_q.shape == (made.problem.robot.nq,)


# Contacts, rows, actuation


def test_contacts_that_are_never_active_are_dropped_unless_a_swing_must_clear_them() -> None:
    robot = biped()
    contacts = (*robot.contacts, Contact(frame="waist", name="back"))
    touching = replace(robot, contacts=contacts)
    cleared = usual(robot)
    problem = push(touching, terms=tuple(t for t in cleared if type(t).__name__ != "SwingClearance"))
    made = smallest(problem, plane=False)
    assert [contact.name for contact in made.problem.robot.contacts] == list(FEET)
    assert any("back" in decision.what for decision in made.report.of_kind("exact"))
    kept = smallest(push(touching, terms=cleared), plane=False)
    assert "back" in [contact.name for contact in kept.problem.robot.contacts]
    lifted = made.lift(solved(made.problem))
    assert lifted.f.shape[1] == 3
    assert not lifted.active[:, 2].any()


def test_without_a_term_on_torques_the_optimum_is_found_without_them() -> None:
    problem = reach(gravity=True)
    made = smallest(problem)
    assert made.problem.actuation == "acceleration"
    assert made.report.is_exact
    assert any(decision.what == "joint torques" for decision in made.report.of_kind("exact"))
    full, own = solved(problem), solved(made.problem)
    assert objective(own) == pytest.approx(objective(full), rel=SAME_OPTIMUM)
    assert_allclose(own.tau, full.tau, atol=SAME_MOTION * problem.robot.weight)
    assert smallest(problem, torques=True).problem.actuation == "torque"


def test_torques_are_modelled_where_they_are_priced_or_limited() -> None:
    for term in (TorqueCost(weight=1.0), TorqueLimits(limit=np.array([5.0]))):
        made = smallest(reach(gravity=True, terms=(AccelerationCost(weight=1.0), term)))
        assert made.problem.actuation == "torque"
    for term in (TorqueCost(weight=0.0), TorqueLimits()):
        made = smallest(reach(gravity=True, terms=(AccelerationCost(weight=1.0), term)))
        assert made.problem.actuation == "acceleration"


def test_limits_beyond_reach_friction_of_grasps_and_flight_are_reported_with_the_reason() -> None:
    report = str(smallest(problems.load("solo12-jump")).report)
    for words in ("no forces", "30 m g l", "more than a turn", "30 sqrt(g / l)", "in the air"):
        assert words in report
    handle = Surface(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), bilateral=True)
    held = Phase(name="stance", duration=0.3, contacts=FEET, surfaces=dict.fromkeys(FEET, handle))
    made = smallest(push(biped(), schedule=Schedule((held,))))
    assert any("friction rows" in decision.what for decision in made.report.decisions)
    assert any("clearance rows" in decision.what for decision in made.report.decisions)


def test_a_velocity_source_is_offered_and_not_taken() -> None:
    made = smallest(reach(terms=(PostureCost(weight=1.0),)))
    assert made.problem.actuation == "acceleration"


def test_phases_in_minimal_coordinates_are_left_as_they_are() -> None:
    problem = problems.load("hopper-hop", coordinates="minimal")
    made = smallest(problem)
    assert made.problem.robot is not None
    assert made.report.before == made.report.after
    assert "minimal coordinates" in made.report.of_kind("kept")[0].why
    with pytest.raises(InputError, match="minimal coordinates"):
        smallest(problem, plane=True)
