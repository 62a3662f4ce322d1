"""Furuta's pendulum: a motor turns an arm about the vertical, the pole at its end swings freely.

Masses and lengths are those of Quanser's QUBE-Servo 2 (user manual), links as cylinders. Its motor
(0.042 N m/A, 8.4 ohm) gives 0.05 N m at 10 V and rest.
"""

import numpy as np
import pinocchio as pin

from trajopt.robot import Robot

KIND = "pendulum"

ARM_MASS, ARM_LENGTH = 0.095, 0.085  # kg and m
POLE_MASS, POLE_LENGTH = 0.024, 0.129
THICKNESS = 0.0095  # m, of both rods
TORQUE = 0.05  # N m


def build() -> Robot:
    """Return the pendulum with its pole hanging: q is the arm's angle about z and the pole's, rad."""
    model = pin.Model()
    model.name = "furuta"
    unlimited = np.array([np.inf])
    arm = model.addJoint(
        0, pin.JointModelRZ(), pin.SE3.Identity(), "arm", np.array([TORQUE]), unlimited, -unlimited, unlimited
    )
    model.addJointFrame(arm)
    model.appendBodyToJoint(arm, _rod(ARM_MASS, ARM_LENGTH, 0), _at(ARM_LENGTH / 2, 0.0))
    model.addBodyFrame("arm_link", arm, pin.SE3.Identity(), -1)
    pole = model.addJoint(arm, pin.JointModelRX(), _at(ARM_LENGTH, 0.0), "pendulum")
    model.addJointFrame(pole)
    model.appendBodyToJoint(pole, _rod(POLE_MASS, POLE_LENGTH, 2), _at(0.0, -POLE_LENGTH / 2))
    model.addBodyFrame("pole", pole, pin.SE3.Identity(), -1)
    model.addFrame(pin.Frame("tip", pole, 0, _at(0.0, -POLE_LENGTH), pin.FrameType.OP_FRAME))
    return Robot.from_model(model, passive=["pendulum"])


def _at(x: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, 0.0, z]))


def _rod(mass: float, length: float, axis: int) -> pin.Inertia:
    """Return the inertia of a cylinder about its centre, along an axis."""
    moments = np.full(3, mass * (3 * (THICKNESS / 2) ** 2 + length**2) / 12)
    moments[axis] = mass * (THICKNESS / 2) ** 2 / 2
    return pin.Inertia(mass, np.zeros(3), np.diag(moments))
