"""Quadrupeds with the same construction: those of Unitree and ANYbotics in example-robot-data."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.robot.contact import Contact
from trajopt.robot.data import robot_file
from trajopt.robot.robot import Robot

UNITREE_LEGS = ("FL", "FR", "RL", "RR")
ANYMAL_LEGS = ("LF", "RF", "LH", "RH")


def unitree(name: str, path: str, *, radius: float, thigh: float, calf: float, hip: float = 0.0) -> Robot:
    """Return a robot of Unitree on four point feet ``FL``, ``FR``, ``RL``, ``RR``, standing.

    path: of the URDF within example-robot-data. radius: of the balls around the foot frames, m. hip, thigh,
    calf: angles of every leg, rad; a positive hip spreads the legs, a calf is bent when negative.
    """
    reference = {}
    for leg in UNITREE_LEGS:
        outwards = hip if leg.endswith("L") else -hip
        for joint, angle in (("hip", outwards), ("thigh", thigh), ("calf", calf)):
            reference[f"{leg}_{joint}_joint"] = angle
    return Robot.from_urdf(
        robot_file(path),
        name=name,
        base="freeflyer",
        contacts=[Contact(frame=f"{leg}_foot", name=leg, radius=radius) for leg in UNITREE_LEGS],
        reference=reference,
    )


def anymal(name: str, path: str, *, radius: float, rise: float) -> Robot:
    """Return an ANYmal on four point feet ``LF``, ``RF``, ``LH``, ``RH``, in its SRDF's "standing".

    Knees point to each other: those in front are bent backwards. Contacts are in frames ``LF_BALL``, ...,
    which this adds: centres of the feet's balls of ``radius`` m, ``rise`` m above the foot frames along z.
    """
    reference = {}
    for leg in ANYMAL_LEGS:
        front, left = leg.endswith("F"), leg.startswith("L")
        reference[f"{leg}_HAA"] = -0.1 if left else 0.1
        reference[f"{leg}_HFE"] = 0.7 if front else -0.7
        reference[f"{leg}_KFE"] = -1.0 if front else 1.0
    described = Robot.from_urdf(robot_file(path), name=name, base="freeflyer")
    model = pin.Model(described.model)
    contacts = [Contact(frame=_add_ball(model, leg, rise), name=leg, radius=radius) for leg in ANYMAL_LEGS]
    return Robot.from_model(
        model,
        name=name,
        base="freeflyer",
        contacts=contacts,
        reference=reference,
        visual=described.visual,
    )


def _add_ball(model: pin.Model, leg: str, rise: float) -> str:
    """Add the frame at the centre of a foot's ball and return its name."""
    foot = model.getFrameId(f"{leg}_FOOT")
    placement = model.frames[foot].placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, rise]))
    parent = model.frames[foot].parentJoint
    model.addFrame(pin.Frame(f"{leg}_BALL", parent, foot, placement, pin.FrameType.OP_FRAME))
    return f"{leg}_BALL"
