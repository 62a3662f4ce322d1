"""xArm 7 of UFACTORY, a seven-joint arm."""

from trajopt.robot import JointLimits, Robot, robot_file

KIND = "arm"
# Flange frame, z pointing out of it.
TOOL = "link_eef"

# Limits of the controller in UFACTORY's manual, 1145 deg/s^2 and 28647 deg/s^3, in rad/s^2 and rad/s^3.
ACCELERATION, JERK = 20.0, 500.0
# Elbow up, flange pointing down in front of the base, far from singularities, unlike the SRDF's postures.
ELBOW_UP = {"joint2": -0.3, "joint4": 0.9, "joint6": 1.2}


def build() -> Robot:
    """Return the arm with a fixed base and no contacts; limits are those of its URDF and its manual."""
    robot = Robot.from_urdf(
        robot_file("xarm_description/urdf/xarm7.urdf"), name="xarm7", base="fixed", reference=ELBOW_UP
    )
    return robot.with_joint_limits(
        [JointLimits(joint=f"joint{i}", acceleration=ACCELERATION, jerk=JERK) for i in range(1, 8)]
    )
