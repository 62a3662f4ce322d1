"""Pruned problems and halves of symmetric robots against the whole: the same optimum, or why not."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from scripts.measure.scenes import upright_jump
from tests.support.models import placement
from tests.support.problems import reach
from tests.support.scenes import (
    FEET,
    SAME_MOTION,
    SAME_OPTIMUM,
    SOLVED,
    biped,
    drive,
    objective,
    push,
    solved,
    symmetrised,
    usual,
)
from trajopt import Contact, InputError, Phase, Problem, Robot, Schedule, Solution, middle_of, terms
from trajopt.certify.report import AT_POINTS
from trajopt.reduced.scenes import smallest
from trajopt.robot import Units, contact_positions, inverse_kinematics
from trajopt.robot.building import leaving_plane
from trajopt.terrain import Surface
from trajopt_library import problems

pytestmark = pytest.mark.long

# Solo12's own asymmetry is 8e-6; of first order in it nothing is left at an optimum.
SOLO12_ASYMMETRY = 1e-5
ARMS = ("left_arm", "right_arm")


@dataclass(frozen=True, kw_only=True)
class FeetWidth(terms.NodeConstraint):
    """Distance between both feet at the end, m: a constraint of a kind that scenes do not know."""

    width: float

    def rows(self, context: terms.Context, units: Units, place: terms.NodePlace) -> terms.Rows:
        left, right = (context.frame(foot).position for foot in FEET)
        return terms.Rows.create(
            ca.vertcat(left[1] - right[1], left[0] - right[0]), [self.width, 0], [self.width, 0], units.length
        )


@dataclass(frozen=True, kw_only=True)
class LeftFootCost(terms.Cost):
    """Where the left foot is: prices one side alone."""

    def residual(self, context: terms.Context, units: Units) -> ca.SX:
        return context.frame(FEET[0]).position / units.length


@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_the_half_of_a_symmetric_robot_has_the_optimum_of_the_whole(tilt: float) -> None:
    problem = push(biped(tilt=tilt))
    keep = ("left_abduction", "right_abduction", *ARMS)
    made = smallest(problem, keep=keep, plane=True)
    assert made.report.is_exact
    assert made.problem.robot.nv == 7
    assert made.problem.robot.contacts[0].rows == (0, 1, 2)
    full, own = solved(problem), solved(made.problem)
    assert objective(own) == pytest.approx(objective(full), rel=SAME_OPTIMUM)
    lifted = made.lift(own)
    assert_allclose(lifted.q, full.q, atol=SAME_MOTION)
    assert_allclose(lifted.f, full.f, atol=SAME_MOTION * problem.robot.weight)
    assert trajopt.check(lifted).base_residual < SOLVED * 10


def hop(robot: Robot, *, impact: bool, free: bool) -> Problem:
    """Stance, flight and landing, by an impact or softly, in a time that is free or not."""
    bounds = {"duration_bounds": (0.1, 0.4)} if free else {}
    extra = [terms.TimeCost(weight=1e-2)] if free else []
    end = usual(robot)
    return push(
        robot,
        terms=(
            *end,
            *extra,
            terms.ImpulseCost(weight=1e-2),
            terms.FrameHeight(frame="waist", height=0.12 + robot.reference[2], at=middle_of("flight")),
        ),
        schedule=Schedule(
            (
                Phase(name="stance", duration=0.3, contacts=FEET),
                Phase(name="flight", duration=0.2, **bounds),
                Phase(name="landing", duration=0.3, contacts=FEET, impact=impact),
            )
        ),
        default_intervals=9,
    )


def test_impacts_free_durations_and_landings_are_those_of_the_whole() -> None:
    problem = hop(biped(), impact=True, free=True)
    made = smallest(problem, keep=("left_abduction", "right_abduction", *ARMS), plane=True)
    assert made.report.is_exact
    full, own = solved(problem), solved(made.problem)
    assert objective(own) == pytest.approx(objective(full), rel=SAME_OPTIMUM)
    lifted = made.lift(own)
    assert lifted.impulse is not None
    assert full.impulse is not None
    assert_allclose(lifted.impulse, full.impulse, atol=SAME_MOTION * problem.robot.weight)
    assert_allclose(lifted.meta["durations"], full.meta["durations"], rtol=SAME_MOTION)


def test_a_saved_half_is_a_file_of_the_whole_robot(tmp_path) -> None:  # type: ignore[no-untyped-def]
    made = smallest(hop(biped(), impact=False, free=False))
    lifted = made.lift(solved(made.problem))
    loaded = Solution.load(lifted.save(tmp_path / "hop.npz"))
    assert loaded.model.nv == biped().nv
    assert loaded.contact_frames == FEET


def test_solo12_jumps_as_half_of_itself_up_to_its_own_asymmetry() -> None:
    problem = problems.load("solo12-jump", distance=0.2)
    made = smallest(problem, intervals=16)
    full, own = solved(problem, 16), solved(made.problem, 16)
    assert not made.report.is_exact
    assert own.statistics.variables < 0.55 * full.statistics.variables
    assert objective(own) == pytest.approx(objective(full), rel=SOLO12_ASYMMETRY)
    assert_allclose(made.lift(own).tau, full.tau, atol=1e-3 * problem.robot.weight)


def test_a_turning_jump_is_not_symmetric_and_the_landing_says_so() -> None:
    made = smallest(problems.load("solo12-jump", yaw="45deg"))
    assert made.problem.robot.nv == 18
    assert made.report.before == made.report.after
    assert any("contact_landing" in decision.why for decision in made.report.of_kind("kept"))


def asymmetric_tasks() -> dict[str, Problem]:
    robot = biped()
    rolled, sideways = robot.reference.copy(), np.zeros(robot.nv)
    rolled[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.05, 0.0, 0.0)).coeffs()
    feet = contact_positions(robot, robot.reference)
    rolled = inverse_kinematics(robot, rolled, feet).q
    sideways[1] = 0.1
    one = Schedule((Phase(name="stance", duration=0.3, contacts=FEET[:1]),))
    wall = Surface(point=feet[FEET[0]], normal=np.array([0.0, 0.3, 1.0]))
    slope = Schedule((Phase(name="stance", duration=0.3, contacts=FEET, surfaces={FEET[0]: wall}),))
    goal = terms.FramePose(frame="waist", position=np.array([0.0, 0.1, 0.6]))
    uneven = np.full(robot.nu, 50.0)
    uneven[0] = 20.0
    endless = tuple(term for term in usual(robot) if not isinstance(term, terms.TerminalState))
    return {
        "level": push(robot, initial_q=rolled, terms=endless),
        "the start": push(robot, initial_v=sideways),
        "contact 'left_foot'": push(robot, schedule=one),
        "the surface under 'left_foot'": push(robot, schedule=slope),
        "frame_pose": push(robot, terms=(*usual(robot), goal)),
        "torque_limits": push(robot, terms=(*usual(robot), terms.TorqueLimits(limit=uneven))),
        "normal_force": push(robot, terms=(*usual(robot), terms.NormalForce(contact=FEET[0], upper=15.0))),
        "left_foot_cost": push(robot, terms=(*usual(robot), LeftFootCost(weight=1.0))),
    }


@pytest.mark.parametrize("what", list(asymmetric_tasks()))
def test_an_asymmetric_task_is_refused_by_the_part_that_is(what: str) -> None:
    with pytest.raises(InputError, match=what):
        smallest(asymmetric_tasks()[what], plane=True)


def test_terms_of_unknown_kinds_and_both_sides_come_with_the_half() -> None:
    robot = biped(tilt=0.15)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    feet = [data.oMf[robot.model.getFrameId(foot)].translation[1] for foot in FEET]
    both = tuple(terms.NormalForce(contact=foot, upper=0.53 * robot.weight) for foot in FEET)
    waist = terms.FramePose(frame="waist", rotation=pin.rpy.rpyToMatrix(0.0, 0.05, 0.0))
    extra = (*both, waist)
    all_terms = tuple(t for t in usual(robot) if type(t).__name__ != "TerminalState")
    problem = push(robot, terms=(*all_terms, *extra))
    keep = ("left_abduction", "right_abduction", *ARMS)
    made = smallest(problem, keep=keep, plane=True)
    full, own = solved(problem), solved(made.problem)
    assert objective(own) == pytest.approx(objective(full), rel=SAME_OPTIMUM)
    lifted = made.lift(own)
    pin.framesForwardKinematics(robot.model, data, lifted.q[-1])
    turned = data.oMf[robot.model.getFrameId("waist")].rotation
    assert_allclose(turned, pin.rpy.rpyToMatrix(0.0, 0.05, 0.0), atol=SAME_MOTION)
    # One row of three turns in the plane, and the other foot's distance follows from this one's.
    width = smallest(
        push(robot, terms=(*all_terms, FeetWidth(width=feet[0] - feet[1]))), keep=keep, plane=True
    )
    assert made.report.after.rows - width.report.after.rows == len(width.problem.schedule.phases) * 12


def test_drives_of_the_whole_robot_price_and_limit_the_half_alike() -> None:
    robot = biped()
    robot = robot.with_drives({name: drive() for name in ("left_hip", "right_hip")})
    all_terms = tuple(term for term in usual(robot) if not isinstance(term, terms.TorqueLimits))
    problem = push(robot, terms=(*all_terms, terms.MotorTorqueCost(weight=1.0), terms.DriveLimits()))
    keep = ("left_abduction", "right_abduction", *ARMS)
    made = smallest(problem, keep=keep, plane=True)
    assert made.report.is_exact
    assert objective(solved(made.problem)) == pytest.approx(objective(solved(problem)), rel=SAME_OPTIMUM)


def test_abduction_is_locked_where_legs_move_in_the_plane_without_it() -> None:
    made = smallest(push(biped()))
    assert made.problem.robot.nv == 5
    assert made.problem.robot.contacts[0].rows == (0, 2)
    assert not leaving_plane(made.problem.robot.model, 1, made.problem.initial_q)
    tilted = smallest(push(biped(tilt=0.15)))
    assert tilted.problem.robot.nv == 6
    assert any("leave the plane" in decision.what for decision in tilted.report.of_kind("kept"))


def test_a_symmetric_task_may_have_a_better_optimum_that_is_not_its_own_image() -> None:
    robot = biped()
    problem = push(robot, terms=(*usual(robot), terms.AccelerationCost(weight=1.0)))
    made = smallest(problem, keep=("left_abduction", "right_abduction", *ARMS), plane=True)
    # From a start that is not its own image: iterates from one that is stay so, but for rounding.
    full, own = solved(problem, perturb=0.01), solved(made.problem)
    # Measured: 0.2693 with a lean to one side against 0.2706.
    assert objective(full) < (1 - SAME_OPTIMUM) * objective(own)
    # It comes in two, each the other's image: the base rolls.
    assert np.abs(full.q[:, 3]).max() > SAME_MOTION
    assert np.abs(made.lift(own).q[:, 3]).max() == 0


def test_a_foothold_to_the_side_keeps_the_abduction() -> None:
    robot = biped()
    feet = {foot: placement(robot.model, robot.reference, foot).translation.copy() for foot in FEET}
    for foot, side in zip(FEET, (1, -1), strict=True):
        feet[foot][1] += 0.05 * side
    problem = hop(robot, impact=False, free=False)
    last = replace(problem.schedule.phases[-1], footholds=feet)
    endless = tuple(term for term in problem.terms if not isinstance(term, terms.TerminalState))
    wide = replace(problem, schedule=Schedule((*problem.schedule.phases[:-1], last)), terms=endless)
    assert smallest(wide).problem.robot.nv == 6


def test_planar_motion_is_that_of_the_half_with_abduction_that_is_worth_little() -> None:
    problem = push(biped())
    with_abduction = smallest(problem, keep=("left_abduction", "right_abduction"))
    in_plane = smallest(problem)
    # Abduction holds the leg's weight sideways, which the planar model does not price.
    difference = objective(solved(in_plane.problem)) / objective(solved(with_abduction.problem)) - 1
    assert abs(difference) < 0.1


def test_an_exactly_symmetric_solo12_passes_the_check_as_half() -> None:
    problem = problems.load("solo12-jump", distance=0.1)
    problem = replace(problem, robot=symmetrised(problem.robot))
    made = smallest(problem)
    assert made.report.is_exact
    own = solved(made.problem)
    report = trajopt.check(made.lift(own))
    assert report.within(AT_POINTS), report.failures(AT_POINTS)


def test_in_the_plane_the_optimum_is_that_of_the_whole_robot_with_abduction_locked() -> None:
    problem = upright_jump().original
    problem = replace(problem, robot=symmetrised(problem.robot))
    legs = [name for name in problem.robot.model.names if name.endswith("HAA")]
    whole = smallest(problem, lock=legs, plane=False).problem
    half = smallest(problem, lock=legs)
    flat = smallest(problem)
    assert (whole.robot.nv, half.problem.robot.nv, flat.problem.robot.nv) == (14, 7, 7)
    found = [objective(solved(entry, 12)) for entry in (whole, half.problem, flat.problem)]
    assert_allclose(found[1:], found[0], rtol=SAME_OPTIMUM)


@dataclass(frozen=True, kw_only=True)
class Hold(terms.PointConstraint):
    """Some joints do not accelerate: from rest, they stay. Its rows are the coordinates' own."""

    joints: tuple[str, ...]

    def rows(self, context: terms.Context, units: Units) -> terms.Rows:
        model = context.robot.model
        held = [context.ddxi[model.joints[model.getJointId(name)].idx_v] for name in self.joints]
        return terms.Rows.create(ca.vertcat(*held), 0, 0, 1.0)


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
    all_terms = [term for term in usual(robot) if not isinstance(term, terms.TorqueCost)]
    above = (*ARMS, "waist_yaw", "waist_pitch")
    problem = push(robot, terms=all_terms)
    made = smallest(problem, plane=False)
    assert set(made.problem.robot.model.names) == set(robot.model.names) - set(above)
    held = solved(replace(problem, terms=(*all_terms, Hold(joints=above))))
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
        {"terms": (*usual(robot), terms.PostureCost(weight=1.0, q=raised))},
        {"initial_v": moving},
        {"terms": (*usual(robot), Hold(joints=("left_arm",)))},
        {"terms": (*usual(robot), terms.FrameHeight(frame="left_arm", height=0.0, at=middle_of("stance")))},
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
    all_terms = (*usual(robot), terms.TorqueLimits(limit=limit))
    made = smallest(push(robot, terms=all_terms), plane=False)
    own = next(t for t in made.problem.terms if isinstance(t, terms.TorqueLimits) and t.limit is not None)
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
    for term in (terms.TorqueCost(weight=1.0), terms.TorqueLimits(limit=np.array([5.0]))):
        made = smallest(reach(gravity=True, terms=(terms.AccelerationCost(weight=1.0), term)))
        assert made.problem.actuation == "torque"
    for term in (terms.TorqueCost(weight=0.0), terms.TorqueLimits()):
        made = smallest(reach(gravity=True, terms=(terms.AccelerationCost(weight=1.0), term)))
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
    made = smallest(reach(terms=(terms.PostureCost(weight=1.0),)))
    assert made.problem.actuation == "acceleration"


def test_phases_in_minimal_coordinates_are_left_as_they_are() -> None:
    problem = problems.load("hopper-hop", coordinates="minimal")
    made = smallest(problem)
    assert made.problem.robot is not None
    assert made.report.before == made.report.after
    assert "minimal coordinates" in made.report.of_kind("kept")[0].why
    with pytest.raises(InputError, match="minimal coordinates"):
        smallest(problem, plane=True)
