"""Bolt, the 1.3 kg biped of the Open Dynamic Robot Initiative: six joints, two point feet."""

from dataclasses import replace

import numpy as np

from trajopt.robot import Contact, Robot, robot_file

from . import solo12

KIND = "biped"
SIDES = {"left": "FL", "right": "FR"}
RADIUS = solo12.RADIUS  # its feet are Solo12's

# Legs of the SRDF's "standing", turned at the hip (there 0.785) until the centre of mass is above the line
# between the feet, with a level torso.
HIP, KNEE = 0.86076393, -1.57079633  # rad
INWARDS = 0.3  # rad

# Bolt uses Solo12's actuators; the 1000 N m and 1000 rad/s of its URDF are placeholders. Torque at the
# largest current, and no-load speed at the 24 V of the robot's supply.
TORQUE = solo12.GEAR_RATIO * solo12.TORQUE_CONSTANT * solo12.CURRENT_LIMIT
SUPPLY = 24.0  # V


def build() -> Robot:
    """Return Bolt on point feet ``left`` and ``right``, in balance over the line between them.

    A foot frame is the centre of the foot's rounded tip.
    Torques are limited to 2.7 N m, rates to 84 rad/s (see above); joints turn freely (10 rad).
    """
    reference = {}
    for side, leg in SIDES.items():
        inwards = -INWARDS if side == "left" else INWARDS
        reference |= {f"{leg}_HAA": inwards, f"{leg}_HFE": HIP, f"{leg}_KFE": KNEE}
    robot = Robot.from_urdf(
        robot_file("bolt_description/robots/bolt.urdf"),
        name="bolt",
        base="freeflyer",
        contacts=[Contact(frame=f"{leg}_FOOT", name=side, radius=RADIUS) for side, leg in SIDES.items()],
        reference=reference,
    )
    rate = solo12.drive(SUPPLY).no_load_speed / solo12.GEAR_RATIO
    rates = np.where(np.isfinite(robot.velocity_limit), rate, np.inf)
    return replace(robot, torque_limit=np.full(robot.nu, TORQUE), velocity_limit=rates)
