"""UR5, the six-joint arm of Universal Robots, bolted to the ground; its tool frame is ``tool0``."""

from trajopt.robot import JointLimits, Robot, robot_file

KIND = "arm"
TOOL = "tool0"
# rad/s^2, the largest that ur_rtde accepts; the manuals of Universal Robots limit no acceleration or jerk.
ACCELERATION = 40.0

# Elbow up, tool pointing down in front of the base, far from the singularities of straight elbow and wrist.
ELBOW_UP = {
    "shoulder_pan_joint": 0.0,
    "shoulder_lift_joint": -1.2,
    "elbow_joint": 1.6,
    "wrist_1_joint": -1.97,
    "wrist_2_joint": -1.57,
    "wrist_3_joint": 0.0,
}


def build() -> Robot:
    """Return the UR5 with a fixed base and no contacts; limits are those of its URDF and ur_rtde."""
    robot = Robot.from_urdf(
        robot_file("ur_description/urdf/ur5_robot.urdf"),
        name="ur5",
        base="fixed",
        reference=ELBOW_UP,
    )
    return robot.with_joint_limits(
        [JointLimits(joint=joint, acceleration=ACCELERATION) for joint in ELBOW_UP]
    )
