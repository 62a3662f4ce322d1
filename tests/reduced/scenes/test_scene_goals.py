"""Pruned problems from robot, schedule and goals; corners that become soles."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from scripts.measure.scenes import SQUAT_INTERVALS, sideways, talos_squat
from tests.support.problems import hopper, one_joint_arm, reach
from tests.support.scene_optima import objective, solved
from tests.support.scenes import FEET, biped, push
from trajopt import Contact, FlatGround, InputError, Phase, Problem, Robot, Schedule
from trajopt.certify.report import AT_POINTS
from trajopt.reduced.scenes.goals import scene
from trajopt.reduced.scenes.smallest_scene import smallest
from trajopt.robot.data import robot_file
from trajopt.terms import (
    AccelerationCost,
    FrictionCone,
    PositionLimits,
    TorqueCost,
    TorqueLimits,
    VelocityLimits,
    WrenchCost,
)
from trajopt_library import robots

# Panda's fingers hold themselves against gravity in the full problem: 2e-6 of the cost, measured.
FINGERS = 1e-5
# Talos: upper body locked against all of its 38 joints, measured 8e-3 of the cost; the half against the
# whole of that, with its own asymmetry of 2e-3, measured 2e-5; in the plane, 1.1e-4.
UPPER_BODY, TALOS_HALF, TALOS_PLANE = 2e-2, 1e-4, 1e-3


# Corners and soles


def corners(robot: Robot) -> Problem:
    """A body on one leg whose foot is given as four points."""
    names = tuple(contact.name for contact in robot.contacts)
    return push(
        robot,
        schedule=Schedule((Phase(name="stance", duration=0.2, contacts=names),)),
        terms=(
            TorqueCost(weight=1.0), AccelerationCost(weight=1e-2), WrenchCost(weight=1e-6),
            FrictionCone(), TorqueLimits(),
        ),
        initial_v=np.array([0.1, 0, 0, 0, 0, 0, 0.1, 0]),
    )  # fmt: skip


def cornered(half_length: float = 0.08, half_width: float = 0.05, skew: float = 0.0) -> Robot:
    robot = hopper("surface")
    model = pin.Model(robot.model)
    foot = model.frames[model.getFrameId("foot")]
    places = [(x, y) for x in (1, -1) for y in (1, -1)]
    for number, (x, y) in enumerate(places):
        offset = np.array([x * half_length + (skew if number == 0 else 0.0), y * half_width, 0.0])
        place = foot.placement * pin.SE3(np.eye(3), offset)
        model.addFrame(pin.Frame(f"corner_{number}", foot.parentJoint, 0, place, pin.OP_FRAME))
    contacts = [Contact(frame=f"corner_{number}") for number in range(4)]
    return Robot.from_model(model, contacts=contacts, name="cornered", reference=robot.reference)


def test_four_corners_become_one_sole_of_their_size() -> None:
    made = smallest(corners(cornered()), plane=False)
    (sole,) = made.problem.robot.contacts
    assert (sole.kind, sole.dimension) == ("surface", 6)
    assert (sole.half_length, sole.half_width) == pytest.approx((0.08, 0.05))
    unknowns = made.report.before.variables - made.report.after.variables
    assert unknowns == 6 * 2 * 6  # 12 - 6 at two points of six intervals


def test_forces_of_a_sole_go_back_to_its_corners_within_their_friction() -> None:
    robot = cornered()
    made = smallest(corners(robot), plane=False)
    own = solved(made.problem)
    lifted = made.lift(own)
    report = trajopt.check(lifted)
    assert report.base_residual < 1e-6
    assert report.friction_margin > -1e-6
    assert report.unilateral_margin > -1e-6
    assert_allclose(lifted.f[:, :, :3].sum(axis=1), own.f[:, 0, :3], atol=1e-6 * robot.weight)


def test_points_that_are_no_rectangle_stay_points() -> None:
    problem = corners(cornered(skew=0.02))
    assert len(smallest(problem, plane=False).problem.robot.contacts) == 4
    assert len(smallest(corners(cornered()), soles=False, plane=False).problem.robot.contacts) == 4


# From robot, schedule and goals


@pytest.mark.long
def test_an_arm_reaches_a_place_and_its_fingers_are_locked() -> None:
    robot = Robot.from_urdf(
        robot_file("panda_description/urdf/panda.urdf"),
        base="fixed",
        reference={"panda_joint2": -0.5, "panda_joint4": -2.2, "panda_joint6": 1.8},
    )
    goal = np.array([0.4, 0.3, 0.5])
    schedule = Schedule((Phase(name="reach", duration=1.0),))
    made = scene(robot, schedule, {"panda_hand": goal}, name="panda")
    assert made.problem.robot.nv == 7
    full, own = solved(made.original, 10), solved(made.problem, 10)
    assert objective(own) == pytest.approx(objective(full), rel=FINGERS)
    lifted = made.lift(own)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, lifted.q[-1])
    assert_allclose(data.oMf[robot.model.getFrameId("panda_hand")].translation, goal, atol=1e-6)
    assert trajopt.check(lifted).within(AT_POINTS)


@pytest.mark.long
def test_a_configuration_is_a_goal_too_and_a_planar_robot_jumps_to_it() -> None:
    robot = robots.load("hopper")
    end = robot.reference.copy()
    end[0] += 0.1
    schedule = Schedule(
        (
            Phase(name="stance", duration=0.4, contacts=("foot",)),
            Phase(name="flight", duration=0.25),
            Phase(name="landing", duration=0.5, contacts=("foot",)),
        )
    )
    made = scene(robot, schedule, end, name="hop")
    solution = solved(made.problem, 24)
    assert_allclose(solution.q[-1, :2], end[:2], atol=1e-3)


@pytest.mark.parametrize(
    ("goals", "words"),
    [
        ({"nose": np.zeros(3)}, "names frame 'nose'"),
        ({"waist": np.zeros(2)}, "3 finite numbers"),
        (np.zeros(3), "goal configuration"),
    ],
)
def test_goals_that_cannot_be_are_refused(goals, words: str) -> None:  # type: ignore[no-untyped-def]
    schedule = Schedule((Phase(name="stance", duration=0.3, contacts=FEET),))
    with pytest.raises(InputError, match=words):
        scene(biped(), schedule, goals)
    with pytest.raises(InputError, match="start of scene"):
        scene(biped(), schedule, start=np.zeros(3))


@pytest.mark.slow
def test_talos_squats_on_the_joints_it_needs_within_measured_differences() -> None:
    made = talos_squat()
    locked = smallest(made.original, plane=False)
    half = smallest(made.original, keep=sideways())
    assert (locked.problem.robot.nv, half.problem.robot.nv, made.problem.robot.nv) == (18, 9, 6)
    found = [
        objective(solved(p, SQUAT_INTERVALS))
        for p in (made.original, locked.problem, half.problem, made.problem)
    ]
    assert found[1] == pytest.approx(found[0], rel=UPPER_BODY)
    assert found[2] == pytest.approx(found[1], rel=TALOS_HALF)
    assert found[3] == pytest.approx(found[1], rel=TALOS_PLANE)
    lifted = made.lift(solved(made.problem, SQUAT_INTERVALS))
    assert trajopt.check(lifted).within(AT_POINTS)


def test_a_robot_of_which_nothing_is_asked_keeps_its_joints() -> None:
    made = smallest(reach(terms=(AccelerationCost(weight=1.0),)), keep=[])
    idle = replace(made.original, terms=(AccelerationCost(weight=1.0),))
    kept = smallest(idle)
    assert kept.problem.robot.nv == 1
    assert any("no joint is needed" in decision.why for decision in kept.report.of_kind("kept"))


def test_ground_and_arm_of_the_reach_are_untouched() -> None:
    made = smallest(reach())
    assert made.problem.robot.nv == one_joint_arm().nv
    assert made.problem.terrain == FlatGround()
    assert not any(isinstance(t, PositionLimits | VelocityLimits) for t in made.problem.terms)
