"""Quadrupeds leap onto a box, down from a box and over a gap: feet clear of its edges, all four at once."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Robot, contact_positions, robot_shapes
from trajopt.terrain import FlatGround, PiecewiseTerrain

from . import common, leaping, pushing

# Robots whose joints are fast enough to carry all feet over an edge in one flight: anymal_c's 7.5 rad/s
# allow a flight of 0.13 s (docs/problems/jumps.md).
ROBOTS = ("solo12", "go2", "a1", "hyq")
# Default durations in units of sqrt(l / g).
STANCE, LANDING = 2.7, 3.4
# Share of the largest speed at take-off, and the largest rise of the base over the robot's length.
SHARE, HEIGHT = 0.75, 0.75
# Height of a box over the rise, and at most over the robot's length; width of a gap over the robot's length.
OF_RISE, MOST_BOX, GAP = 0.5, 0.5, 0.3
# Distance of feet from an edge at take-off and landing, over the robot's length.
FROM_EDGE = 0.15
# Distance of other links from a box at landing, at least; where the knees need it, the landing moves in
# steps, up to so many, all over the robot's length. Distances agree to rounding, m.
LEAST_GAP, STEP, MOST_STEPS, ROUNDING = 0.03, 0.05, 20, 1e-6

Kind = Literal["box-up", "box-down", "gap"]


def _site(
    robot: Robot, kind: Kind, size: float, friction: float
) -> tuple[PiecewiseTerrain, np.ndarray, np.ndarray]:
    """Obstacle of a height or width ``size`` m ahead of the front feet; all feet land beyond its edge.

    And where a robot that stands at the origin starts and ends (3,) m.
    """
    feet = np.array(list(contact_positions(robot, robot.reference).values()))
    keep = FROM_EDGE * robot.length
    front, hind = feet[:, 0].max() + keep, feet[:, 0].min() - keep
    length, width = front - hind, np.ptp(feet[:, 1]) + robot.length
    start, end, up = np.zeros(3), np.array([length, 0.0, 0.0]), np.array([0.0, 0.0, size])
    if kind == "gap":
        terrain = PiecewiseTerrain.gap(size, at=(front, 0.0), friction=friction)
        return terrain, start, np.array([length + size, 0.0, 0.0])
    middle = (front + hind) / 2 + (length if kind == "box-up" else 0.0)
    terrain = PiecewiseTerrain.box(size, length, width, at=(middle, 0.0), friction=friction)
    if kind == "box-up":
        return terrain, start, end + up
    return terrain, start + up, _clear_of_box(robot, terrain, end)


def _clear_of_box(robot: Robot, terrain: PiecewiseTerrain, end: np.ndarray) -> np.ndarray:
    """The place (3,) m at ``end`` or beyond where a robot stands with its links clear of the box behind it.

    Of the reference posture: the knees of some lean back farther than their feet are from the edge.
    """
    shapes = robot_shapes(robot)
    level, box = (shapes.scene(robot.model, ground) for ground in (FlatGround(), terrain))
    for steps in range(MOST_STEPS):
        place = end + np.array([steps * STEP * robot.length, 0.0, 0.0])
        apart = level.distances(common.displaced(robot, place))
        least = np.minimum(apart, LEAST_GAP * robot.length) - ROUNDING
        if (box.distances(common.displaced(robot, place)) >= least).all():
            break
    return place


def build(
    *,
    robot: str,
    rise: float | None,
    friction: float,
    torque_limit: float | None,
    kind: Kind,
    **given: float | None,
) -> Problem:
    """Build the leap; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = common.quadruped(robot)
    takeoff, unit = pushing.takeoff(body, torque_limit), common.natural_time(body)
    highest = pushing.apex(takeoff, SHARE, HEIGHT * body.length)
    size, default = "height", min(OF_RISE * highest, MOST_BOX * body.length)
    if kind == "gap":
        size, default = "width", GAP * body.length
    own = common.filled({size: default, "stance": STANCE * unit, "landing": LANDING * unit}, given)
    terrain, start, end = _site(body, kind, own[size], friction)
    climb = float(end[2] - start[2])
    rise = max(highest, climb) if rise is None else rise
    if rise < climb:
        raise InputError(f"the base rises by {rise:g} m onto a box of {climb:g} m", "allowed: rise >= height")
    own = {"flight": pushing.flight_time(takeoff, rise, -climb)} | own
    return leaping.problem(
        f"quadruped-{kind}",
        takeoff,
        (common.displaced(body, start), common.displaced(body, end)),
        (own["stance"], own["flight"], own["landing"]),
        terrain=terrain,
        torque_limit=torque_limit,
        heights=(start[2], end[2]),
        parameters=own | {"rise": rise},
    )


def _family(kind: Kind, summary: str) -> Family:
    size = (
        common.length("width", None, "width of the gap", (1e-3, 5.0))
        if kind == "gap"
        else common.length("height", None, "height of the box", (1e-3, 2.0))
    )
    meaning = "rise of the base in flight, which gives the default flight duration"
    return Family(
        name=f"quadruped-{kind}",
        robots=ROBOTS,
        phases=("stance", "flight", "landing"),
        summary=summary,
        parameters=(
            size,
            common.length("rise", None, meaning, (0.0, 5.0)),
            *common.hop_durations("from the rise"),
            common.friction(0.7),
            common.TORQUE_LIMIT,
        ),
        build=partial(build, kind=kind),
    )


FAMILIES = (
    _family("box-up", "leap from the ground onto a box and come to rest on it"),
    _family("box-down", "leap down from a box and come to rest before it"),
    _family("gap", "leap over a gap in the ground, all four feet at once"),
)
