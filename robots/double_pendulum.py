"""The double pendulum of example-robot-data: two links on parallel horizontal axes, a motor on each."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.robot import Robot, robot_file

KIND = "pendulum"
# The links point up at zero.
HANGING = {"joint1": math.pi, "joint2": 0.0}


def build() -> Robot:
    """Return the pendulum, hanging: angles are continuous, zero is upright, both joints have motors.

    The description writes zeros for "no limit". Here rates are unlimited, and a motor's torque is limited
    to the largest moment of the weight behind its joint, the pendulum stretched and level (0.74 and
    0.33 N m): it just holds what it carries. Its joint damping is not part of the dynamics.
    """
    robot = hanging(name="double_pendulum")
    return replace(robot, torque_limit=weight_moments(robot.model))


def hanging(*, name: str, passive: tuple[str, ...] = ()) -> Robot:
    """Return the links, hanging, without limits of torques and rates."""
    robot = Robot.from_urdf(
        robot_file("double_pendulum_description/urdf/double_pendulum_continuous.urdf"),
        name=name,
        base="fixed",
        reference=HANGING,
        passive=passive,
    )
    return replace(robot, velocity_limit=np.full(robot.nv, np.inf), torque_limit=None)


def weight_moments(model: pin.Model) -> np.ndarray:
    """Largest moment (nv,) in N m of the weight about each joint, the pendulum stretched."""
    turns = np.linspace(0.0, 2 * math.pi, 361)
    stretched = [np.array([math.cos(t), math.sin(t), 1.0, 0.0]) for t in turns]
    moments = [pin.computeGeneralizedGravity(model, model.createData(), q) for q in stretched]
    largest: np.ndarray = np.abs(moments).max(axis=0)
    return largest
