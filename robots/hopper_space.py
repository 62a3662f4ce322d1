"""The hopper in space: torso and leg of the planar hopper on a free base, its hip with a second axis."""

import pinocchio as pin

from trajopt.robot import Robot

from .hopper import FOOT, add_joint, add_leg, add_torso, standing

KIND = "hopper"
ROLL_RANGE = (-0.8, 0.8)  # rad; leg to the left is negative


def build() -> Robot:
    """Return the hopper on a free-flyer base, its hip at the base's origin, standing on its foot.

    Nine degrees of freedom, three of them actuated: ``hip_roll`` about the torso's x axis, then ``hip`` and
    ``knee`` about the leg's y axis. Bodies, limits and motors are those of `robots.hopper`.
    """
    model = pin.Model()
    model.name = "hopper_space"
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    add_torso(model, base)
    roll = add_joint(model, base, "hip_roll", pin.SE3.Identity(), ROLL_RANGE, pin.JointModelRX())
    add_leg(model, roll, pin.SE3.Identity())
    return Robot.from_model(model, name="hopper_space", contacts=[FOOT], reference=standing())
