"""Shared by the problems of bipeds: the robot with its legs alone, poses of the base, two steps."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from trajopt.errors import InputError
from trajopt.reduced import BaseWaypoint
from trajopt.robot import Robot, biped_legs, contact_positions, legs_only, require_soles
from trajopt.schedule import Schedule, footholds_at
from trajopt_library import robots

from . import common

ROBOTS = ("talos", "g1", "bolt")
HUMANOIDS = ("g1_arms", "talos_arms")  # with hands
# Fractions of a stance on heel and toe.
ROLLS = {"heel": 1 / 6, "toe": 1 / 4}
ROLLING = (
    common.choice("feet", "soles stay flat, or roll from heel to toe", "flat", "heel-toe"),
    *(
        common.number(
            name, None, "", f"part of each stance on the {name} (default: {part:.2g}, of heel-toe)", (0, 0.9)
        )
        for name, part in ROLLS.items()
    ),
)


@lru_cache(maxsize=8)
def biped(name: str | Robot) -> Robot:
    """The robot of that name on its two feet, all joints outside the legs locked at the reference.

    These tasks do not need arms, waist or head: they are rigid parts of the trunk. Raises InputError if the
    robot is not a biped.
    """
    robot = robots.load(name)
    biped_legs(robot)
    return legs_only(robot)


def rolls_of(robot: Robot, feet: str, heel: float | None, toe: float | None) -> tuple[float, float] | None:
    """Parts of a stance on heel and toe, of the parameters ``ROLLING``; None for flat feet.

    Raises InputError for parts of flat feet, and a robot without soles.
    """
    given = {name: part for name, part in (("heel", heel), ("toe", toe)) if part is not None}
    if feet == "flat":
        for name in given:
            raise InputError(f"parameter {name} is given, but feet is flat", "allowed: with feet=heel-toe")
        return None
    require_soles(robot)
    parts = ROLLS | given
    return parts["heel"], parts["toe"]


def waypoint(robot: Robot, time: float, shift: Sequence[float] | np.ndarray) -> BaseWaypoint:
    """The reference's base at ``time`` s, displaced by ``shift`` m in the world."""
    return BaseWaypoint(time=time, position=robot.reference[:3] + np.array(shift))


def two_steps(robot: Robot, way: np.ndarray, durations: Mapping[str, float]) -> Schedule:
    """Both feet move by ``way`` (3,) m, right foot first, in five phases of ``durations`` s by name."""
    left, right = biped_legs(robot)
    places = {name: place + way for name, place in footholds_at(robot, robot.reference).items()}
    contacts = ((left, right), (left,), (left, right), (right,), (left, right))
    return common.schedule_of(durations, contacts, places)


@lru_cache(maxsize=8)
def humanoid(name: str | Robot) -> Robot:
    """The robot of that name, on two feet and with two hands among its contacts.

    Raises InputError for a robot without them.
    """
    robot = robots.load(name)
    hands(robot)
    return robot


def hands(robot: Robot) -> tuple[str, str]:
    """Contacts of a robot's left and right hand: those that are no feet. Raises InputError."""
    places, feet = contact_positions(robot, robot.reference), biped_legs(robot)
    found = sorted((name for name in places if name not in feet), key=lambda name: -places[name][1])
    if len(found) != 2:
        raise InputError(
            f"'{robot.name}' has these contacts that are not feet: {', '.join(found) or 'none'}",
            f"allowed: two, its hands, as of {' and '.join(HUMANOIDS)}",
        )
    return found[0], found[1]
