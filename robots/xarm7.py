"""xArm 7 of UFACTORY, a seven-joint arm."""

from trajopt.robot import Robot, robot_file

KIND = "arm"
# Flange frame, z pointing out of it.
TOOL = "link_eef"

# Elbow up, flange pointing down in front of the base, far from singularities, unlike the SRDF's postures.
ELBOW_UP = {"joint2": -0.3, "joint4": 0.9, "joint6": 1.2}


def build() -> Robot:
    """Return the arm with a fixed base and no contacts; limits are those of its URDF."""
    return Robot.from_urdf(
        robot_file("xarm_description/urdf/xarm7.urdf"), name="xarm7", base="fixed", reference=ELBOW_UP
    )
