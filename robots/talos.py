"""Talos, the 90 kg humanoid of PAL Robotics: two soles, and the left hand as a point (`talos_arms`: both)."""

from trajopt.robot import Contact, Robot, robot_file

KIND = "biped"
SIDES = ("left", "right")
SOLES = {side: f"{side}_sole_link" for side in SIDES}
HAND = "wrist_left_ft_tool_link"
# Rectangle of flat rubber within the outline of the foot, m.
HALF_LENGTH, HALF_WIDTH = 0.1, 0.06
# Legs of the SRDF posture "half_sitting"; the left arm is in front of the body with a bent elbow.
HALF_SITTING = {"3": -0.411, "4": 0.859, "5": -0.448}
ARM = {"1": 0.25, "2": 0.25, "3": 0.0, "4": -1.6, "5": 0.0, "6": 0.0, "7": 0.0}
LOCKED = ("gripper", "head", "torso")
# Centre of the contact ball between the gripper's finger tips, in the frame of the wrist's flange.
GRIP_CENTRE, GRIP_RADIUS = (0.0, 0.0, -0.15), 0.03  # m
PATH = "talos_data/robots/talos_reduced.urdf"


def build() -> Robot:
    """Return Talos on two soles with the joints of both legs and the left arm, limits of its URDF.

    The trunk, the head, the grippers and the right arm are locked. Contacts are ``left`` and ``right``
    (soles of 20 by 12 cm) and ``hand``, a point at the left wrist's tool flange.
    """
    right = {"arm_right_2_joint": -0.17, "arm_right_4_joint": -0.53}
    robot = Robot.from_urdf(
        robot_file(PATH),
        name="talos",
        contacts=[*_soles(), Contact(frame=HAND, name="hand")],
        reference=_legs() | _arm("left") | right,
    )
    return robot.with_locked([name for name in robot.model.names if name.startswith(("arm_right", *LOCKED))])


def with_arms() -> Robot:
    """Return Talos with both arms; contacts ``left_hand`` and ``right_hand`` are the ends of its grippers."""
    hands = {f"{side}_hand": (f"wrist_{side}_ft_tool_link", GRIP_CENTRE, (0.0, 0.0, 0.0)) for side in SIDES}
    robot = Robot.from_urdf(
        robot_file(PATH),
        name="talos_arms",
        frames=hands,
        contacts=[*_soles(), *(Contact(frame=hand, radius=GRIP_RADIUS) for hand in hands)],
        reference=_legs() | _arm("left") | _arm("right"),
    )
    return robot.with_locked([name for name in robot.model.names if name.startswith(LOCKED)])


def _soles() -> list[Contact]:
    return [
        Contact(frame=frame, name=side, kind="surface", half_length=HALF_LENGTH, half_width=HALF_WIDTH)
        for side, frame in SOLES.items()
    ]


def _legs() -> dict[str, float]:
    return {f"leg_{side}_{joint}_joint": q for side in SIDES for joint, q in HALF_SITTING.items()}


def _arm(side: str) -> dict[str, float]:
    """Return the posture of an arm; for the right one all axes but the elbow are mirrored."""
    signs = {joint: 1.0 if side == "left" or joint == "4" else -1.0 for joint in ARM}
    return {f"arm_{side}_{joint}_joint": signs[joint] * q for joint, q in ARM.items()}
