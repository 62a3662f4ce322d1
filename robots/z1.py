"""Z1 of Unitree, a light six-joint arm with a gripper, whose jaw is locked."""

from trajopt.robot import Robot, robot_file

KIND = "arm"
# Mounting frame of the gripper, x pointing out of it.
TOOL = "link06"

# Elbow up, gripper pointing forward and 46 degrees down (straight down, the wrist would be near its limit).
# The SRDF's "home" is folded, at the limits.
ELBOW_UP = {"joint2": 1.9, "joint3": -1.4, "joint4": 0.3}


def build() -> Robot:
    """Return the arm with a fixed base and no contacts; limits are those of its URDF."""
    return Robot.from_urdf(
        robot_file("z1_description/urdf/z1.urdf"),
        name="z1",
        base="fixed",
        reference=ELBOW_UP,
        locked=["jointGripper"],
    )
