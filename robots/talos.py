"""Talos, the 90 kg humanoid of PAL Robotics: two soles, and the left hand as a point contact."""

from trajopt.robot import Contact, Robot, robot_file

KIND = "biped"
SIDES = ("left", "right")
SOLES = {side: f"{side}_sole_link" for side in SIDES}
HAND = "wrist_left_ft_tool_link"
# Rectangle of flat rubber within the foot's outline, m.
HALF_LENGTH, HALF_WIDTH = 0.1, 0.06
# Legs of the SRDF's posture "half_sitting"; the left arm in front of the body, elbow bent.
HALF_SITTING = {"3": -0.411, "4": 0.859, "5": -0.448}
ARM = {"1": 0.25, "2": 0.25, "3": 0.0, "4": -1.6, "5": 0.0, "6": 0.0, "7": 0.0}
LOCKED = ("arm_right", "gripper", "head", "torso")


def build() -> Robot:
    """Return Talos on two soles with the joints of both legs and the left arm, limits of its URDF.

    The trunk, the head, the grippers and the right arm are locked. Contacts are ``left`` and ``right``
    (soles of 20 by 12 cm) and ``hand``, a point at the left wrist's tool flange.
    """
    soles = [
        Contact(frame=frame, name=side, kind="surface", half_length=HALF_LENGTH, half_width=HALF_WIDTH)
        for side, frame in SOLES.items()
    ]
    legs = {f"leg_{side}_{joint}_joint": q for side in SIDES for joint, q in HALF_SITTING.items()}
    arm = {f"arm_left_{joint}_joint": q for joint, q in ARM.items()}
    right = {"arm_right_2_joint": -0.17, "arm_right_4_joint": -0.53}
    path = robot_file("talos_data/robots/talos_reduced.urdf")
    robot = Robot.from_urdf(
        path,
        name="talos",
        contacts=[*soles, Contact(frame=HAND, name="hand")],
        reference=legs | arm | right,
    )
    return robot.with_locked([name for name in robot.model.names if name.startswith(LOCKED)])
