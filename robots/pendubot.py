"""The pendubot: the links of the double pendulum with a motor at the first joint and a passive elbow."""

from dataclasses import replace

from trajopt.robot import Robot

from .double_pendulum import hanging, weight_moments

KIND = "pendulum"


def build() -> Robot:
    """Return the pendubot, hanging: see `robots.double_pendulum`; its second joint has no actuator.

    The motor's torque is limited to the largest moment of the whole pendulum's weight about the first
    joint (0.74 N m).
    """
    robot = hanging(name="pendubot", passive=("joint2",))
    return replace(robot, torque_limit=weight_moments(robot.model)[:1])
