"""Quadrupeds with the same construction: those of Unitree and ANYbotics in example-robot-data."""

from __future__ import annotations

from trajopt.robot.contact import Contact
from trajopt.robot.data import robot_file
from trajopt.robot.robot import Robot

UNITREE_LEGS = ("FL", "FR", "RL", "RR")
ANYMAL_LEGS = ("LF", "RF", "LH", "RH")


def unitree(name: str, path: str, *, thigh: float, calf: float, hip: float = 0.0) -> Robot:
    """Return a robot of Unitree on four point feet ``FL``, ``FR``, ``RL``, ``RR``, standing.

    path: of the URDF within example-robot-data. hip, thigh, calf: angles of every leg, rad; a positive
    hip spreads the legs, a calf is bent when negative.
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
        contacts=[Contact(frame=f"{leg}_foot", name=leg) for leg in UNITREE_LEGS],
        reference=reference,
    )


def anymal(name: str, path: str) -> Robot:
    """Return an ANYmal on four point feet ``LF``, ``RF``, ``LH``, ``RH``, in its SRDF's "standing".

    Knees point to each other: those in front are bent backwards.
    """
    reference = {}
    for leg in ANYMAL_LEGS:
        front, left = leg.endswith("F"), leg.startswith("L")
        reference[f"{leg}_HAA"] = -0.1 if left else 0.1
        reference[f"{leg}_HFE"] = 0.7 if front else -0.7
        reference[f"{leg}_KFE"] = -1.0 if front else 1.0
    return Robot.from_urdf(
        robot_file(path),
        name=name,
        base="freeflyer",
        contacts=[Contact(frame=f"{leg}_FOOT", name=leg) for leg in ANYMAL_LEGS],
        reference=reference,
    )
