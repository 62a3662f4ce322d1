"""Quadrupeds leap onto a box, down from a box and over a gap: feet clear of its edges, all four at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Family
from trajopt.problem.problem import Problem
from trajopt.reduced.legged_guess import legged_guess
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.terms import TerminalRest, TerminalState
from trajopt.terrain.piecewise import PiecewiseTerrain

from . import common, leaping

# Robots whose joints are fast enough to carry all feet over an edge in one flight: anymal_c's 7.5 rad/s
# allow a flight of 0.13 s (docs/problems/jumps.md).
ROBOTS = ("solo12", "go2", "a1", "hyq")
# Default durations in units of sqrt(l / g).
STANCE, LANDING = 2.7, 3.4
# Share of the largest speed at take-off, and the most that the base rises, part of the robot's length.
SHARE, HEIGHT = 0.75, 0.75
# A box is this part of the rise high, at most this part of the robot's length; a gap this part of it wide.
OF_RISE, MOST_BOX, GAP = 0.5, 0.5, 0.3
# Feet stand and land this far from an edge, part of the robot's length.
FROM_EDGE = 0.15

Kind = Literal["box-up", "box-down", "gap"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Site:
    """An obstacle before a robot that stands at the origin: the terrain, where it starts and ends (3,) m."""

    terrain: PiecewiseTerrain
    start: np.ndarray
    end: np.ndarray


def _site(robot: Robot, kind: Kind, size: float, friction: float) -> Site:
    """Obstacle of a height or width ``size`` m ahead of the front feet; all feet land beyond its edge."""
    feet = np.array(list(contact_positions(robot, robot.reference).values()))
    keep = FROM_EDGE * robot.length
    front, hind = feet[:, 0].max() + keep, feet[:, 0].min() - keep
    length, width = front - hind, np.ptp(feet[:, 1]) + robot.length
    up = np.array([0.0, 0.0, size])
    if kind == "gap":
        terrain = PiecewiseTerrain.gap(size, at=(front, 0.0), friction=friction)
        return Site(terrain=terrain, start=np.zeros(3), end=np.array([length + size, 0.0, 0.0]))
    middle = (front + hind) / 2 + (length if kind == "box-up" else 0.0)
    terrain = PiecewiseTerrain.box(size, length, width, at=(middle, 0.0), friction=friction)
    start, end = np.zeros(3), np.array([length, 0.0, 0.0])
    if kind == "box-up":
        return Site(terrain=terrain, start=start, end=end + up)
    return Site(terrain=terrain, start=start + up, end=end)


def build(
    *,
    robot: str,
    height: float | None = None,
    width: float | None = None,
    rise: float | None,
    stance: float | None,
    flight: float | None,
    landing: float | None,
    friction: float,
    effort: float | None,
    kind: Kind,
) -> Problem:
    """Build the leap; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = leaping.quadruped(robot)
    takeoff, unit = leaping.takeoff(body, effort), leaping.natural_time(body)
    highest = leaping.apex(takeoff, SHARE, HEIGHT * body.length)
    if kind == "gap":
        size = GAP * body.length if width is None else width
    else:
        size = min(OF_RISE * highest, MOST_BOX * body.length) if height is None else height
    site = _site(body, kind, size, friction)
    climb = float(site.end[2] - site.start[2])
    rise = max(highest, climb) if rise is None else rise
    if rise < climb:
        raise InputError(f"the base rises by {rise:g} m onto a box of {climb:g} m", "allowed: rise >= height")
    flight = leaping.flight_time(takeoff, rise, -climb) if flight is None else flight
    durations = (
        STANCE * unit if stance is None else stance,
        flight,
        LANDING * unit if landing is None else landing,
    )
    start, end = (leaping.displaced(body, place) for place in (site.start, site.end))
    schedule = common.hop_schedule(contact_positions(body, end), durations)
    leap = leaping.Leap(
        robot=body,
        start=start[:3],
        end=end[:3],
        durations=durations,
        rise=takeoff.rise,
        turn=np.zeros(3),
    )
    lift = leaping.clearance(body, flight)
    guess = legged_guess(body, schedule, leap.waypoints(), start=start, terrain=site.terrain, clearance=lift)
    heights = {"stance": site.start[2], "landing": site.end[2], "flight": min(site.start[2], site.end[2])}
    return Problem(
        name=f"quadruped-{kind}",
        robot=body,
        schedule=schedule,
        terrain=site.terrain,
        initial_q=start,
        initial_v=np.zeros(body.nv),
        terms=(
            *leaping.leap_terms(body, schedule, site.terrain, guess, effort=effort, clearance=lift),
            *leaping.above_ground(body, heights),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=guess,
        parameters={
            ("width" if kind == "gap" else "height"): size,
            "rise": rise,
            "stance": durations[0],
            "flight": flight,
            "landing": durations[2],
        },
    )


def _family(kind: Kind, summary: str) -> Family:
    def built(**parameters: object) -> Problem:
        return build(kind=kind, **parameters)  # type: ignore[arg-type]

    size = (
        leaping.scaled("width", "m", (1e-3, 5.0), "of the gap")
        if kind == "gap"
        else leaping.scaled("height", "m", (1e-3, 2.0), "of the box")
    )
    return Family(
        name=f"quadruped-{kind}",
        robots=ROBOTS,
        phases=("stance", "flight", "landing"),
        summary=summary,
        parameters=(
            size,
            leaping.scaled("rise", "m", (0.0, 5.0), "of the base in flight, from which its duration follows"),
            leaping.scaled("stance", "s", (1e-3, 10.0), "duration of the push"),
            leaping.scaled("flight", "s", (1e-3, 3.0), "duration of the flight (default: from the rise)"),
            leaping.scaled("landing", "s", (1e-3, 10.0), "duration from touchdown to rest"),
            common.friction(0.7),
            common.effort(),
        ),
        build=built,
    )


FAMILIES = (
    _family("box-up", "leap from the ground onto a box and come to rest on it"),
    _family("box-down", "leap down from a box and come to rest before it"),
    _family("gap", "leap over a gap in the ground, all four feet at once"),
)
