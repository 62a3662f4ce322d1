"""The planar hopper is the machine that its figures describe."""

import numpy as np
import pinocchio as pin
import pytest

from trajopt_library import robots
from trajopt_library.robots import hopper

ROUNDING = 1e-12


def points(q: np.ndarray) -> dict[str, np.ndarray]:
    """Hip, knee, foot and torso centre (3,) m by hand: angles from the vertical, nose up positive."""
    x, z, cosine, sine, hip, knee = q
    pitch = np.arctan2(sine, cosine)
    thigh = pitch - hip  # Pinocchio's y axis turns nose down
    shank = thigh - knee
    at = np.array([x, 0.0, z])

    def down(angle: float) -> np.ndarray:
        return np.array([np.sin(angle), 0.0, -np.cos(angle)])

    knee_point = at + hopper.THIGH_LENGTH * down(thigh)
    return {
        "hip": at,
        "knee": knee_point,
        "foot": knee_point + hopper.SHANK_LENGTH * down(shank),
        "torso": at - hopper.TORSO_CENTRE * hopper.TORSO_LENGTH * down(pitch),
        "thigh": at + hopper.THIGH_LENGTH / 2 * down(thigh),
        "shank": knee_point + hopper.SHANK_LENGTH / 2 * down(shank),
    }


POSTURE = np.array([0.3, 0.8, np.cos(0.4), np.sin(0.4), -0.7, 1.3])


def test_sizes_base_and_weight():
    robot = robots.load("hopper")
    assert (robot.base, robot.nq, robot.nv, robot.nu, robot.n_unactuated) == ("planar", 6, 5, 2, 3)
    assert robot.mass == pytest.approx(10.0)
    assert [contact.name for contact in robot.contacts] == ["foot"]


def test_frames_lie_where_the_links_angles_put_them():
    model = robots.load("hopper").model
    data = model.createData()
    pin.framesForwardKinematics(model, data, POSTURE)
    for name in ("hip", "knee", "foot"):
        found = data.oMf[model.getFrameId(name)].translation
        np.testing.assert_allclose(found, points(POSTURE)[name], atol=ROUNDING)


def test_the_centre_of_mass_is_that_of_three_boxes():
    model = robots.load("hopper").model
    masses = {"torso": hopper.TORSO_MASS, "thigh": hopper.THIGH_MASS, "shank": hopper.SHANK_MASS}
    at = points(POSTURE)
    expected = sum(mass * at[name] for name, mass in masses.items()) / sum(masses.values())
    found = pin.centerOfMass(model, model.createData(), POSTURE)
    np.testing.assert_allclose(found, expected, atol=ROUNDING)


def test_the_pitch_inertia_of_a_turning_body_is_that_of_its_boxes():
    """All links turn with the torso: the kinetic energy is that of one rigid body about the hip."""
    robot, rate = robots.load("hopper"), 2.0
    v = np.array([0.0, 0.0, rate, 0.0, 0.0])
    at, expected = points(POSTURE), 0.0
    for name, mass, length in (
        ("torso", hopper.TORSO_MASS, hopper.TORSO_LENGTH),
        ("thigh", hopper.THIGH_MASS, hopper.THIGH_LENGTH),
        ("shank", hopper.SHANK_MASS, hopper.SHANK_LENGTH),
    ):
        side = hopper.SLENDERNESS * length
        own = mass * (length**2 + side**2) / 12
        expected += (own + mass * np.sum((at[name] - at["hip"]) ** 2)) * rate**2 / 2
    found = pin.computeKineticEnergy(robot.model, robot.model.createData(), POSTURE, v)
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_reference_stands_with_its_weight_over_the_foot():
    robot = robots.load("hopper")
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    foot = data.oMf[robot.model.getFrameId("foot")].translation
    assert foot[2] == pytest.approx(0.0, abs=ROUNDING)
    centre = pin.centerOfMass(robot.model, data, robot.reference)
    assert centre[0] == pytest.approx(foot[0], abs=ROUNDING)


def test_joints_can_hold_the_weight_on_a_bent_leg():
    robot = robots.load("hopper")
    lever = hopper.THIGH_LENGTH
    assert (robot.torque_limit > 2 * robot.weight * lever).all()
    np.testing.assert_array_equal(robot.velocity_limit[3:], hopper.SPEED)
