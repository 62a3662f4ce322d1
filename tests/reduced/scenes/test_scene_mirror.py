"""Pruned problems from goals, mirror symmetry from geometry, and the half of a robot against the whole."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import trajopt
from scripts.measure.scenes import SQUAT_INTERVALS, sideways, talos_squat
from tests.support.problems import hopper, one_joint_arm, reach
from tests.support.scenes import FEET, biped, drive, objective, push, solved, symmetrised
from trajopt import Contact, FlatGround, InputError, Phase, Problem, Robot, Schedule, terms
from trajopt.certify.report import AT_POINTS
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.reduced.scenes import scene, smallest
from trajopt.reduced.scenes.half import half_robot, turned_by_mirror
from trajopt.reduced.scenes.reduction import Reduction, lock_joints
from trajopt.robot import robot_file
from trajopt.robot.mirror import (
    find_mirror,
    limit_differences,
    mirrored_configuration,
    mirrored_rows,
    paired_contacts,
    pairs,
)
from trajopt_library import robots

# Rounding of sums over some ten bodies, parts of the largest entry.
ROUNDING = 1e-10
# What descriptions made from CAD differ from their mirror image, parts of mass and length.
DESCRIBED = 2e-2
TOLERANCE = 1e-3

REAL = {
    "solo12": ("solo_description/robots/solo12.urdf", "{}_FOOT", ("FL", "FR", "HL", "HR")),
    "a1": ("a1_description/urdf/a1.urdf", "{}_foot", ("FL", "FR", "RL", "RR")),
    "anymal": ("anymal_c_simple_description/urdf/anymal.urdf", "{}_FOOT", ("LF", "RF", "LH", "RH")),
    "talos": ("talos_data/robots/talos_reduced.urdf", "{}_sole_link", ("left", "right")),
}


def real(name: str) -> Robot:
    path, frame, sides = REAL[name]
    return Robot.from_urdf(robot_file(path), name=name, contacts=[frame.format(side) for side in sides])


def _other_side(name: str) -> str:
    """Name of the leg's joint on the other side: FL_ is FR_, LF_ is RF_, RL_ is RR_."""
    place = 0 if name[1] in "FH" else 1
    return name[:place] + {"L": "R", "R": "L"}[name[place]] + name[place + 1 :]


def half_of(robot: Robot) -> Reduction:
    """The half with its waist's yaw locked, at the reference."""
    mirror = find_mirror(robot)
    turned = turned_by_mirror(robot, mirror)
    straight = lock_joints(robot, turned, robot.reference).small
    mirror = find_mirror(straight)
    return half_robot(straight, mirror, paired_contacts(straight, mirror, TOLERANCE), straight.reference)


@pytest.mark.parametrize("name", REAL)
def test_legs_of_real_robots_are_found_in_pairs_by_geometry(name: str) -> None:
    robot = real(name)
    mirror = find_mirror(robot)
    assert 0 < mirror.asymmetry < DESCRIBED
    for left, right in pairs(robot, mirror):
        here, there = robot.model.names[left], robot.model.names[right]
        assert there == (here.replace("left", "right") if "left" in here else _other_side(here))
    assert paired_contacts(robot, mirror, TOLERANCE) in ((1, 0, 3, 2), (1, 0))


def test_signs_come_from_axes_not_from_names() -> None:
    robot = biped()
    mirror, model = find_mirror(robot), robot.model
    signs = {model.names[left]: mirror.sign[left] for left, _ in pairs(robot, mirror)}
    # The right hip's axis points the other way, the abductions' axes along x do not.
    assert signs == {"left_abduction": -1.0, "left_hip": -1.0, "left_knee": 1.0, "left_arm": 1.0}
    assert mirror.asymmetry < ROUNDING


def test_a_waist_may_pitch_in_the_plane_but_not_yaw() -> None:
    robot = biped(waist=True)
    assert turned_by_mirror(robot, find_mirror(robot)) == ("waist_yaw",)


def test_a_heavier_thigh_is_reported_with_its_size_and_place() -> None:
    robot = biped(heavier=1.5)
    mirror = find_mirror(robot)
    assert "hip" in mirror.worst
    assert mirror.asymmetry == pytest.approx(0.5 * 0.8 / robot.mass, rel=1e-6)


def test_a_limb_without_counterpart_is_no_mirror_image() -> None:
    model = pin.Model(biped().model)
    joint = model.addJoint(1, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.0])), "tail")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    mirror = find_mirror(Robot.from_model(model, contacts=FEET))
    assert mirror.asymmetry > DESCRIBED
    assert "tail" in mirror.worst


def test_fixed_and_planar_bases_have_no_mirror_plane_of_their_own() -> None:
    arm = Robot.from_urdf(robot_file("ur_description/urdf/ur5_robot.urdf"), base="fixed")
    with pytest.raises(InputError, match="fixed base"):
        find_mirror(arm)


def test_a_foot_off_its_mirrored_place_has_no_image() -> None:
    robot = biped()
    model = pin.Model(robot.model)
    frame = model.frames[model.getFrameId("right_foot")]
    frame.placement = frame.placement * pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
    moved = Robot.from_model(model, contacts=[Contact(frame=foot) for foot in FEET])
    with pytest.raises(InputError, match="no mirror image"):
        paired_contacts(moved, find_mirror(moved), TOLERANCE)


def test_limits_that_differ_are_named() -> None:
    robot = biped()
    upper = robot.position_upper.copy()
    upper[robot.model.joints[robot.model.getJointId("right_hip")].idx_q] = 0.5
    narrow = replace(robot, position_upper=upper)
    assert limit_differences(robot, find_mirror(robot)) == []
    assert "'right_hip'" in limit_differences(narrow, find_mirror(narrow))[0]


def test_the_mirror_image_of_a_state_has_mirrored_frames_and_velocities() -> None:
    robot = biped(waist=True)
    mirror, model, data = find_mirror(robot), robot.model, robot.model.createData()
    generator = np.random.default_rng(0)
    q = pin.integrate(model, robot.reference, generator.uniform(-0.5, 0.5, model.nv))
    v = generator.uniform(-1, 1, model.nv)
    index, sign = mirrored_rows(robot, mirror)
    # Pinocchio's twists of the base are in its axes, which are mirrored with it.
    y0 = 0.3
    found = []
    for state in ((q, v), (mirrored_configuration(robot, mirror, q, y0), sign * v[index])):
        pin.forwardKinematics(model, data, *state)
        pin.updateFramePlacements(model, data)
        found.append(
            {
                foot: (
                    data.oMf[model.getFrameId(foot)].translation.copy(),
                    pin.getFrameVelocity(
                        model, data, model.getFrameId(foot), pin.LOCAL_WORLD_ALIGNED
                    ).linear.copy(),
                )
                for foot in FEET
            }
        )
    flip = np.array([1.0, -1.0, 1.0])
    for own, image in (FEET, FEET[::-1]):
        place, velocity = found[0][own]
        assert_allclose(found[1][image][0], flip * place + [0, 2 * y0, 0], atol=ROUNDING)
        assert_allclose(found[1][image][1], flip * velocity, atol=ROUNDING)


@pytest.mark.parametrize("make", [lambda: biped(waist=True, tilt=0.2), lambda: symmetrised(real("solo12"))])
def test_dynamics_of_the_half_are_those_of_the_whole_along_mirrored_motions(make) -> None:  # type: ignore[no-untyped-def]
    robot = make()
    reduction = half_of(robot)
    whole, small = reduction.whole, reduction.small
    assert small.nv == 3 + reduction.joints.__len__() / 2 + (0.5 if "waist_pitch" in reduction.joints else 0)
    generator = np.random.default_rng(1)
    data, half_data = whole.model.createData(), small.model.createData()
    frames = [whole.model.getFrameId(c.frame) for c in whole.contacts]
    half_frames = [small.model.getFrameId(c.frame) for c in small.contacts]
    for _ in range(3):
        q = pin.integrate(small.model, small.reference, generator.uniform(-0.5, 0.5, small.nv))
        v, a = generator.uniform(-1, 1, (2, small.nv))
        f = generator.uniform(-1, 1, (1, len(small.contacts), 6))
        f[..., 3:] = 0.0
        lifted = reduction.lift_q(q), reduction.rates @ v, reduction.rates @ a
        forces = reduction.lift_forces(f)[0]
        full = generalized_force(whole.model, data, lifted, frames, forces)
        own = generalized_force(small.model, half_data, (q, v, a), half_frames, f[0])
        scale = np.abs(own).max()
        assert_allclose(reduction.rates.T @ full, own, atol=ROUNDING * scale)
        # No force of a mirrored motion leaves the plane: lateral, roll and yaw rows of the base vanish.
        assert_allclose(full[[1, 3, 5]], 0.0, atol=ROUNDING * scale)
        assert_allclose(reduction.shares @ own[small.n_unactuated :], full[6:], atol=ROUNDING * scale)
        mass = pin.crba(whole.model, data, lifted[0])
        mass = np.triu(mass) + np.triu(mass, 1).T
        half_mass = pin.crba(small.model, half_data, q)
        half_mass = np.triu(half_mass) + np.triu(half_mass, 1).T
        assert_allclose(reduction.rates.T @ mass @ reduction.rates, half_mass, atol=ROUNDING * scale)


def test_frames_of_the_half_are_where_the_whole_robot_has_them_or_their_images() -> None:
    robot = biped(waist=True, tilt=0.2)
    reduction = half_of(robot)
    whole, small = reduction.whole.model, reduction.small.model
    data, half_data = whole.createData(), small.createData()
    q = pin.integrate(small, pin.neutral(small), np.random.default_rng(2).uniform(-0.5, 0.5, small.nv))
    pin.framesForwardKinematics(small, half_data, q)
    pin.framesForwardKinematics(whole, data, reduction.lift_q(q))
    assert reduction.mirrored_frames >= {"right_foot", "right_hip"}
    for name in ("left_foot", "right_foot", "waist"):
        place = half_data.oMf[small.getFrameId(name)].translation
        if name in reduction.mirrored_frames:
            place = reduction.reflected_point(place)
        assert_allclose(data.oMf[whole.getFrameId(name)].translation, place, atol=ROUNDING)


def test_configurations_and_rates_go_there_and_back() -> None:
    reduction = half_of(biped(waist=True))
    small, generator = reduction.small, np.random.default_rng(3)
    q = pin.integrate(small.model, small.reference, generator.uniform(-0.5, 0.5, small.nv))
    v = generator.uniform(-1, 1, small.nv)
    assert_allclose(reduction.drop_q(reduction.lift_q(q)), q, atol=ROUNDING)
    assert_allclose(reduction.drop_v(reduction.rates @ v), v, atol=ROUNDING)


def test_limits_and_drives_of_a_pair_are_merged() -> None:
    robot = biped()
    motors = {name: drive() for name in ("left_hip", "right_hip")}
    reduction = half_of(robot.with_drives(motors))
    small = reduction.small
    row = small.model.joints[small.model.getJointId("left_hip")].idx_v - 3
    assert small.drives is not None
    assert small.torque_limit is not None
    merged, single = small.drives[row], drive()
    assert merged is not None
    assert merged.armature == pytest.approx(2 * single.armature)
    assert small.model.armature[row + 3] == pytest.approx(2 * single.armature)
    assert small.torque_limit[row] == pytest.approx(2 * single.joint_torque_limit)
    assert merged.joint_no_load_speed == pytest.approx(single.joint_no_load_speed)
    assert small.velocity_limit[row + 3] == pytest.approx(robot.velocity_limit[6])
    # What the pair delivers at a rate is twice what one does, and so is its share of voltage equal.
    torque, rate = 10.0, 3.0
    assert merged.friction_torque(rate) == pytest.approx(2 * single.friction_torque(rate))
    assert merged.voltage_use(2 * torque, rate) == pytest.approx(single.voltage_use(torque, rate))


def test_feet_of_a_planar_robot_may_slide_sideways_only_if_its_legs_stay_in_the_plane() -> None:
    path, _, sides = REAL["solo12"]
    planar = Robot.from_urdf(robot_file(path), base="planar", contacts=[f"{side}_FOOT" for side in sides])
    assert all(contact.rows == (0, 1, 2) for contact in planar.contacts)
    abductions = [name for name in planar.model.names if name.endswith("HAA")]
    assert all(contact.rows == (0, 2) for contact in planar.with_locked(abductions).contacts)


def test_an_asymmetric_robot_is_kept_whole_with_the_reason_and_refused_if_it_must_be_halved() -> None:
    problem = push(biped(heavier=1.5))
    made = smallest(problem)
    assert made.problem.robot.base == "freeflyer"
    assert any("differs from its mirror image" in decision.why for decision in made.report.of_kind("kept"))
    with pytest.raises(InputError, match="differs from its mirror image"):
        smallest(problem, plane=True)


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
            terms.TorqueCost(weight=1.0), terms.AccelerationCost(weight=1e-2), terms.WrenchCost(weight=1e-6),
            terms.FrictionCone(), terms.TorqueLimits(),
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
    made = smallest(reach(terms=(terms.AccelerationCost(weight=1.0),)), keep=[])
    idle = replace(made.original, terms=(terms.AccelerationCost(weight=1.0),))
    kept = smallest(idle)
    assert kept.problem.robot.nv == 1
    assert any("no joint is needed" in decision.why for decision in kept.report.of_kind("kept"))


def test_ground_and_arm_of_the_reach_are_untouched() -> None:
    made = smallest(reach())
    assert made.problem.robot.nv == one_joint_arm().nv
    assert made.problem.terrain == FlatGround()
    assert not any(isinstance(t, terms.PositionLimits | terms.VelocityLimits) for t in made.problem.terms)
