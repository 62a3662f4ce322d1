"""Mirror symmetry from geometry; the half of a robot against Pinocchio's dynamics of the whole."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.scenes import FEET, biped, drive, push, symmetrised
from trajopt import Contact, InputError, Robot
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.reduced.scenes.half import half_robot, turned_by_mirror
from trajopt.reduced.scenes.reduction import Reduction, lock_joints
from trajopt.reduced.scenes.smallest_scene import smallest
from trajopt.robot.data import robot_file
from trajopt.robot.mirror import (
    find_mirror,
    limit_differences,
    mirrored_configuration,
    mirrored_rows,
    paired_contacts,
    pairs,
)

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
