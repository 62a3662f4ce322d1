"""The planar hopper of the lecture: a torso, a thigh and a shank in a vertical plane, on a point foot."""

import math

import numpy as np
import pinocchio as pin

from trajopt.robot import Robot, sagittal

KIND = "hopper"
FOOT = "foot"

# Masses in kg and lengths in m of a small one-legged machine of 10 kg, most of it in the torso.
TORSO_MASS, TORSO_LENGTH = 7.0, 0.4
THIGH_MASS, THIGH_LENGTH = 2.0, 0.35
SHANK_MASS, SHANK_LENGTH = 1.0, 0.35
# Links are slender boxes of this thickness over their length.
SLENDERNESS = 0.2
# Height of the torso's centre of mass above the hip, over the torso's length.
TORSO_CENTRE = 0.25

# Joint side, N m and rad/s: three times the moment of the weight at a thigh's length; hips and knees of
# electric legs of this size reach 20 rad/s.
TORQUE = 100.0
SPEED = 20.0
HIP_RANGE = (-1.6, 1.6)  # rad; thigh forward is negative
KNEE_RANGE = (0.05, 2.6)  # rad; bent, with the shank back, is positive
# Rotor inertia at the joint, kg m^2: a rotor of 5e-5 kg m^2 behind a gear ratio of 12.
ARMATURE = 7.2e-3
STANDING_KNEE = 1.2  # rad


def build() -> Robot:
    """Return the hopper on a planar base, its hip at the base's origin, standing on its foot.

    q is (x, z, cos, sin of the pitch, hip, knee): five degrees of freedom, two of them actuated.
    """
    model = pin.Model()
    model.name = "hopper"
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    add_torso(model, base)
    model = sagittal(model)
    add_leg(model, base, model.jointPlacements[base].inverse())
    return Robot.from_model(model, name="hopper", contacts=[FOOT], reference=standing())


def add_torso(model: pin.Model, base: int) -> None:
    """Attach the torso to the joint ``base``, its hip at the joint's origin."""
    model.addJointFrame(base)
    torso = _box(TORSO_MASS, TORSO_LENGTH)
    model.appendBodyToJoint(base, torso, _at(0.0, TORSO_CENTRE * TORSO_LENGTH))
    model.addBodyFrame("torso", base, pin.SE3.Identity(), -1)


def add_leg(model: pin.Model, parent: int, placement: pin.SE3) -> None:
    """Attach thigh, shank and foot to the joint ``parent``: hip and knee turn about y of ``placement``."""
    hip = add_joint(model, parent, "hip", placement, HIP_RANGE, pin.JointModelRY())
    model.appendBodyToJoint(hip, _box(THIGH_MASS, THIGH_LENGTH), _at(0.0, -THIGH_LENGTH / 2))
    model.addBodyFrame("thigh", hip, pin.SE3.Identity(), -1)
    knee = add_joint(model, hip, "knee", _at(0.0, -THIGH_LENGTH), KNEE_RANGE, pin.JointModelRY())
    model.appendBodyToJoint(knee, _box(SHANK_MASS, SHANK_LENGTH), _at(0.0, -SHANK_LENGTH / 2))
    model.addBodyFrame("shank", knee, pin.SE3.Identity(), -1)
    model.addFrame(pin.Frame(FOOT, knee, 0, _at(0.0, -SHANK_LENGTH), pin.FrameType.OP_FRAME))


def standing() -> dict[str, float]:
    """Hip and knee (rad) of the posture whose centre of mass, the torso upright, lies over the foot.

    With the thigh leaning forward by t and the shank by t - knee, foot and centre of mass are aligned if
    ``a sin(t) + b sin(t - knee) = 0``.
    """
    mass = TORSO_MASS + THIGH_MASS + SHANK_MASS
    a = THIGH_LENGTH * (1 - (THIGH_MASS / 2 + SHANK_MASS) / mass)
    b = SHANK_LENGTH * (1 - SHANK_MASS / 2 / mass)
    thigh = math.atan2(b * math.sin(STANDING_KNEE), a + b * math.cos(STANDING_KNEE))
    return {"hip": -thigh, "knee": STANDING_KNEE}


def _at(x: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, 0.0, z]))


def _box(mass: float, length: float) -> pin.Inertia:
    """Return the inertia of an upright solid box about its centre, its sides `SLENDERNESS` of its length."""
    side = SLENDERNESS * length
    return pin.Inertia.FromBox(mass, side, side, length)


def add_joint(
    model: pin.Model,
    parent: int,
    name: str,
    placement: pin.SE3,
    limits: tuple[float, float],
    axis: pin.JointModel,
) -> int:
    """Add a joint with the hopper's motor (torque, rate, armature) and return its number."""
    lower, upper = (np.array([limit]) for limit in limits)
    joint = model.addJoint(parent, axis, placement, name, np.array([TORQUE]), np.array([SPEED]), lower, upper)
    model.addJointFrame(joint)
    model.armature[model.joints[joint].idx_v] = ARMATURE
    return int(joint)
