"""Unitree G1, the 33 kg humanoid, on two soles; waist and arms are locked (the arms of `g1_arms` are not)."""

import numpy as np
import pinocchio as pin

from trajopt.robot import Contact, Robot, robot_file

KIND = "biped"
SIDES = ("left", "right")

# The foot touches with four balls of 5 mm radius. In the URDF they are at x = -50 and 120 mm from the ankle,
# 30 mm below it, and at y = -25 and 25 mm (in front 30 mm). This is the rectangle between their centres.
SOLE_CENTRE = (0.035, 0.0, -0.035)  # m, in the frame of the ankle
HALF_LENGTH, HALF_WIDTH = 0.085, 0.025  # m

# Knees are bent so that legs can lengthen by a seventh. Feet are level, and the hips place the centre of mass
# above the middle of the soles.
HIP_PITCH, KNEE, ANKLE_PITCH = -0.5253, 1.1, -0.5747  # rad
# Arms hang beside the body with bent elbows.
SHOULDER_PITCH, SHOULDER_ROLL, ELBOW = 0.2, 0.2, 0.9  # rad
ARMS = ("shoulder", "elbow", "wrist")
# Centre of the contact ball at the fingertips, in the left rubber hand's frame; mirrored for the right hand.
HAND_CENTRE, HAND_RADIUS = (0.1, -0.02, 0.01), 0.03  # m

# Rotor inertia on the joint side, kg m^2, as in MuJoCo Menagerie's unitree_g1/g1.xml; the URDF has none.
ARMATURE = 0.01


def build() -> Robot:
    """Return G1 with the twelve joints of its legs, standing on soles ``left`` and ``right`` of 17 by 5 cm.

    Contacts are in frames ``left_sole`` and ``right_sole``, which this adds: on the ground below the ankle,
    in the middle of the balls that touch. Limits are those of the URDF.
    """
    return _robot("g1", ("waist", *ARMS), hands=False)


def with_arms() -> Robot:
    """Return G1 with the joints of its arms as well, and contacts ``left_hand`` and ``right_hand``: balls."""
    return _robot("g1_arms", ("waist",), hands=True)


def _robot(name: str, locked: tuple[str, ...], *, hands: bool) -> Robot:
    path = robot_file("g1_description/urdf/g1_29dof_rev_1_0.urdf")
    described = Robot.from_urdf(path, name=name)
    model, level = pin.Model(described.model), (0.0, 0.0, 0.0)
    frames = {f"{side}_sole": (f"{side}_ankle_roll_link", SOLE_CENTRE, level) for side in SIDES}
    contacts = [
        Contact(frame=sole, name=side, kind="surface", half_length=HALF_LENGTH, half_width=HALF_WIDTH)
        for side, sole in zip(SIDES, frames, strict=True)
    ]
    x, y, z = HAND_CENTRE
    if hands:
        model.armature = np.append(np.zeros(6), np.full(model.nv - 6, ARMATURE))
        for side, across in zip(SIDES, (y, -y), strict=True):
            frames[f"{side}_hand"] = f"{side}_rubber_hand", (x, across, z), level
            contacts.append(Contact(frame=f"{side}_hand", radius=HAND_RADIUS))
    return Robot.from_model(
        model,
        name=name,
        base="freeflyer",
        frames=frames,
        contacts=contacts,
        reference=_posture(),
        locked=[name for name in model.names if any(part in name for part in locked)],
        visual=described.visual,
    )


def _posture() -> dict[str, float]:
    posture = {}
    for side in SIDES:
        outwards = SHOULDER_ROLL if side == "left" else -SHOULDER_ROLL
        posture |= {
            f"{side}_hip_pitch_joint": HIP_PITCH,
            f"{side}_knee_joint": KNEE,
            f"{side}_ankle_pitch_joint": ANKLE_PITCH,
            f"{side}_shoulder_pitch_joint": SHOULDER_PITCH,
            f"{side}_shoulder_roll_joint": outwards,
            f"{side}_elbow_joint": ELBOW,
        }
    return posture
