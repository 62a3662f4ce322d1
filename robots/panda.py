"""Panda of Franka Emika, the seven-joint arm with its hand; the fingers are locked."""

from trajopt.robot import JointLimits, Robot, robot_file

KIND = "arm"
# Frame between the finger tips, z pointing out of the hand.
TOOL = "panda_hand_tcp"
# Limits of libfranka (rate_limiting.h), beyond which the arm stops: rad/s^2, jerks in rad/s^3 over them, and
# N m/s.
ACCELERATION, JERK, TORQUE_RATE = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0), 500.0, 1000.0
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")

# Posture "default" of the SRDF with closed fingers: elbow up, hand pointing down in front of the base.
READY = {
    "panda_joint1": 0.0,
    "panda_joint2": -0.785398,
    "panda_joint3": 0.0,
    "panda_joint4": -2.35619,
    "panda_joint5": 0.0,
    "panda_joint6": 1.5707,
    "panda_joint7": 0.785398,
}


def build() -> Robot:
    """Return the Panda with a fixed base and no contacts; limits are those of its URDF and of libfranka."""
    robot = Robot.from_urdf(
        robot_file("panda_description/urdf/panda.urdf"),
        name="panda",
        base="fixed",
        reference=READY,
        locked=FINGERS,
    )
    return robot.with_joint_limits(
        [
            JointLimits(
                joint=f"panda_joint{i}",
                acceleration=acceleration,
                jerk=JERK * acceleration,
                torque_rate=TORQUE_RATE,
            )
            for i, acceleration in enumerate(ACCELERATION, 1)
        ]
    )
