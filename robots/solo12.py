"""Solo12, the 2.5 kg quadruped of the Open Dynamic Robot Initiative (twelve joints, four point feet)."""

from __future__ import annotations

from trajopt.robot import Robot
from trajopt.robot_data import robot_file

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")

# The posture "standing" of the robot's SRDF: knees inwards, legs slightly spread.
STANDING = {
    "FL_HAA": 0.1,
    "FL_HFE": 0.8,
    "FL_KFE": -1.6,
    "FR_HAA": -0.1,
    "FR_HFE": 0.8,
    "FR_KFE": -1.6,
    "HL_HAA": 0.1,
    "HL_HFE": -0.8,
    "HL_KFE": 1.6,
    "HR_HAA": -0.1,
    "HR_HFE": -0.8,
    "HR_KFE": 1.6,
}


def build() -> Robot:
    """Return Solo12 with a floating base and four point feet, standing with its feet at height 0.

    A foot frame is the centre of the foot's rounded tip (radius 16 mm), not the point that
    touches: terrain heights of this robot are heights of those centres, 16 mm above the
    ground one sees. Limits are those of the URDF, which are placeholders (10 rad,
    1000 rad/s, 1000 N m); problems that need the motors' own limits state them.
    """
    return Robot.from_urdf(
        robot_file("solo_description/robots/solo12.urdf"),
        name="solo12",
        base="freeflyer",
        contacts=FEET,
        reference=STANDING,
    )
