"""Quadrupeds leap onto a box, down from a box and over a gap: feet clear of its edges, all four at once."""

import math
from functools import partial
from typing import Literal

import numpy as np

from trajopt.collision import robot_shapes
from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Robot, Units, contact_positions
from trajopt.terrain import FlatGround, PiecewiseTerrain

from . import common, leaping, pushing

# Robots whose joints are fast enough to carry all feet over an edge in one flight; anymal_c's 7.5 rad/s allow
# a flight of 0.13 s (docs/problems/jumps.md).
ROBOTS = ("solo12", "go2", "a1", "hyq")
# Default durations in units of sqrt(l / g).
STANCE, LANDING = 2.7, 3.4
# Share of the largest take-off speed, and largest rise of the base over the robot's length; then the share
# for a box, onto which legs have to be drawn up.
SHARE, HEIGHT, SHARE_UP = 0.75, 0.75, 0.9
# Fall of the base onto a box, over the robot's length, which gives time to bring all feet over its edge.
FALL = 0.12
# Height of a box over the rise; its largest value, and the width of a gap, over the robot's length.
OF_RISE, MOST_BOX, GAP = 0.5, 0.5, 0.3
# Distance of feet from an edge at take-off and landing, over the robot's length.
FROM_EDGE = 0.15
# Least distance of other links from a box at landing, over the robot's length. If the knees need it, the
# landing moves away in steps over the length, up to this number. Rounding error of distances, m.
LEAST_GAP, STEP, MOST_STEPS, ROUNDING = 0.03, 0.05, 20, 1e-6

Kind = Literal["box-up", "box-down", "gap"]


def _site(
    robot: Robot, kind: Kind, size: float, friction: float
) -> tuple[PiecewiseTerrain, np.ndarray, np.ndarray]:
    """Return an obstacle of height or width ``size`` m ahead of the front feet, and start and end (3,) m.

    All feet land beyond its edge. Start and end are displacements of a robot that stands at the origin.
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
        return terrain, _clear_of_box(robot, terrain, start, -1.0), end + up
    return terrain, start + up, _clear_of_box(robot, terrain, end, 1.0)


def _clear_of_box(robot: Robot, terrain: PiecewiseTerrain, near: np.ndarray, away: float) -> np.ndarray:
    """Return a place (3,) m, from ``near`` in direction ``away`` (1 or -1), where links are clear of the box.

    They are clear in the reference posture and with the base sunk. Knees that lean back and heads that reach
    forward extend farther than the feet are from the edge.
    """
    shapes = robot_shapes(robot)
    level, box = (shapes.scene(robot.model, ground) for ground in (FlatGround(), terrain))
    postures = np.array([robot.reference, pushing.raised(robot, -pushing.sink_of(robot)).q])
    least = np.minimum(level.distances(postures), LEAST_GAP * robot.length) - ROUNDING
    for steps in range(MOST_STEPS):
        place = near + np.array([away * steps * STEP * robot.length, 0.0, 0.0])
        moved = postures.copy()
        moved[:, :3] += place
        if (box.distances(moved) >= least).all():
            break
    return place


def _leap(takeoff: pushing.Takeoff, climb: float, rise: float | None) -> tuple[float, float]:
    """Return the base's rise over its start, and its height over its end at touchdown, m.

    Legs extend as far at touchdown as at take-off, unless that leaves no time to bring the feet over the edge
    of a box. Then the robot leaps higher and lands on bent legs.
    """
    length, extended = takeoff.robot.length, takeoff.rise
    fall = FALL * length if climb > 0 else 0.0
    needed = climb + extended + fall
    if rise is None:
        usual = pushing.apex(takeoff, SHARE, HEIGHT * length)
        lowest = climb - pushing.sink_of(takeoff.robot) + fall
        rise = max(usual, min(needed, max(pushing.apex(takeoff, SHARE_UP, needed), lowest)))
    return rise, min(extended, max(rise - climb - fall, -pushing.sink_of(takeoff.robot)))


def build(
    *,
    robot: str,
    rise: float | None,
    friction: float,
    torque_limit: float | None,
    yaw: float,
    kind: Kind,
    **given: float | None,
) -> Problem:
    """Build the leap; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = common.quadruped(robot)
    takeoff, unit = pushing.takeoff(body, torque_limit), Units(body).time
    highest = pushing.apex(takeoff, SHARE, HEIGHT * body.length)
    size, default = "height", min(OF_RISE * highest, MOST_BOX * body.length)
    if kind == "gap":
        size, default = "width", GAP * body.length
    values = common.filled({size: default, "stance": STANCE * unit, "landing": LANDING * unit}, given)
    terrain, start, end = _site(body, kind, values[size], friction)
    climb = float(end[2] - start[2])
    rise, touchdown = _leap(takeoff, climb, rise)
    least = climb - pushing.sink_of(body)
    if rise < least:
        raise InputError(
            f"the base rises by {rise:g} m onto a box of {climb:g} m", f"allowed: rise >= {least:.3g} m"
        )
    values = {"flight": pushing.flight_time(takeoff, rise, takeoff.rise - touchdown - climb)} | values
    return leaping.problem(
        f"quadruped-{kind}",
        takeoff,
        (common.displaced(body, start), common.displaced(body, end, yaw)),
        (values["stance"], values["flight"], values["landing"]),
        terrain=terrain,
        torque_limit=torque_limit,
        turn=yaw,
        heights=(start[2], end[2]),
        touchdown_rise=touchdown,
        parameters=values | {"rise": rise},
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
            common.angle("yaw", 0.0, "turn to the left", (-math.pi, math.pi)),
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
