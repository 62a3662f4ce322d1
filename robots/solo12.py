"""Solo12, the 2.5 kg quadruped of the Open Dynamic Robot Initiative (twelve joints, four point feet)."""

import math

from trajopt.robot import Contact, Drive, Robot, robot_file

KIND = "quadruped"
BASE = "base_link"
FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
# Radius of a foot's rounded tip, m: its collision mesh reaches 15.6 to 16.1 mm below the foot frame while the
# shank leans by up to 60 degrees, and by 20 degrees to the side.
RADIUS = 0.016

# Posture "standing" of the robot's SRDF: knees inwards, legs slightly spread.
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

# Actuator of the Open Dynamic Robot Initiative: a T-Motor Antigravity 4004 300 kV with 12 pole pairs behind
# two 3:1 belts. Its identification (mechanics/actuator_module_v1/README.md of open_robot_actuator_hardware)
# gives 0.23255 ohm per phase and a rated flux of 0.00954 V/Hz. Torque constant, rotor inertia and largest
# current are those of robot_properties_solo and its controllers.
GEAR_RATIO = 9.0
PHASE_RESISTANCE = 0.23255  # ohm
BACK_EMF_CONSTANT = 12 * 0.00954 / (2 * math.pi)  # V s/rad, amplitude of a phase, motor side
TORQUE_CONSTANT = 0.025  # N m/A, amplitude of a phase, motor side
CURRENT_LIMIT = 12.0  # A: 2.7 N m at the joint; the module is specified with 2.5 N m at 12 A
ROTOR_INERTIA = 4.5e-6  # kg m^2, motor side


def drive(voltage: float) -> Drive:
    """Return the drive of every joint at a supply of ``voltage`` V (the robot's own has 24 V).

    Space-vector modulation gives a phase an amplitude of voltage / sqrt 3. At 24 V the no-load speed
    is then 761 rad/s; 300 rpm/V times 24 V, the maker's figure, is 754 rad/s.
    """
    return Drive.from_motor(
        gear_ratio=GEAR_RATIO,
        voltage=voltage / math.sqrt(3),
        resistance=PHASE_RESISTANCE,
        torque_constant=TORQUE_CONSTANT,
        back_emf_constant=BACK_EMF_CONSTANT,
        current_limit=CURRENT_LIMIT,
        rotor_inertia=ROTOR_INERTIA,
    )


def build() -> Robot:
    """Return Solo12 with a floating base and four point feet, standing on level ground at height 0.

    A foot frame is the centre of the foot's rounded tip. Limits are those of the URDF, which are
    placeholders (10 rad, 1000 rad/s, 1000 N m); problems that need the motors' own limits state them.
    """
    return Robot.from_urdf(
        robot_file("solo_description/robots/solo12.urdf"),
        name="solo12",
        base="freeflyer",
        contacts=[Contact(frame=foot, radius=RADIUS) for foot in FEET],
        reference=STANDING,
    )
