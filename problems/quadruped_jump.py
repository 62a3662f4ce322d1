"""Jumps of quadrupeds from level ground to level ground: up, forward, sideways and turning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from trajopt.problem.family import Family
from trajopt.problem.problem import Problem
from trajopt.reduced.legged_guess import legged_guess
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Schedule
from trajopt.terms import FrameHeight, TerminalRest, TerminalState, effort_costs, goal_terms
from trajopt.terrain.flat import FlatGround

from . import common, leaping

ROBOTS = ("solo12", "go2", "anymal_c", "a1", "hyq")
# Default durations in units of sqrt(l / g): solo12 pushes for 0.4 s and comes to rest in 0.5 s.
STANCE, LANDING = 2.7, 3.4
# Rises of the base and ways forward and to the left are at most these parts of the robot's length, turns at
# most this, rad; where joints are too slow, less.
HEIGHT, LEAST_HEIGHT, FORWARD, SIDEWAYS, TURN = 0.75, 0.4, 1.0, 0.5, math.pi / 2
# Shares of the largest speeds at take-off: upwards in a jump up, upwards in others, across and turning.
SHARE_UP, SHARE_LOW, SHARE_ACROSS = 0.75, 0.6, 0.25

# For least time durations are free within these multiples of theirs.
FREE = (0.5, 2.0)
# Motions of free durations are faster and want more intervals for feet that do not drift.
INTERVALS, FREE_INTERVALS = 50, 80

# Which way a jump goes by default.
Direction = Literal["up", "forward", "sideways", "turn"]


def _defaults(takeoff: leaping.Takeoff, direction: Direction, height: float | None) -> dict[str, float]:
    """Defaults of a jump: as large as its robot's length suggests and its speeds at take-off allow."""
    length = takeoff.robot.length
    high = direction in ("up", "turn")
    share, most = (SHARE_UP, HEIGHT) if direction == "up" else (SHARE_LOW, HEIGHT if high else LEAST_HEIGHT)
    rise = leaping.apex(takeoff, share, most * length) if height is None else height
    flight = leaping.flight_time(takeoff, rise)
    forward, left = (SHARE_ACROSS * speed * flight for speed in takeoff.across)
    turn = SHARE_ACROSS * takeoff.turn * flight
    unit = leaping.natural_time(takeoff.robot)
    return {
        "distance": min(FORWARD * length, forward) if direction == "forward" else 0.0,
        "sideways": min(SIDEWAYS * length, left) if direction == "sideways" else 0.0,
        "yaw": min(TURN, turn) if direction == "turn" else 0.0,
        "height": rise,
        "flight": flight,
        "stance": STANCE * unit,
        "landing": LANDING * unit,
    }


def build(
    *,
    robot: str,
    friction: float,
    effort: float | None,
    goal: str,
    direction: Direction,
    kind: str = "quadruped",
    load: Callable[[str], Robot] = leaping.quadruped,
    **given: float | None,
) -> Problem:
    """Build the jump; see ``FAMILIES`` for the parameters. Raises InputError.

    ``load`` gives the robot of a name if it is of that ``kind``.
    """
    body = load(robot)
    takeoff = leaping.takeoff(body, effort)
    chosen = _defaults(takeoff, direction, given["height"])
    chosen |= {key: value for key, value in given.items() if value is not None}
    end = leaping.displaced(body, (chosen["distance"], chosen["sideways"], 0.0), chosen["yaw"])
    durations = (chosen["stance"], chosen["flight"], chosen["landing"])
    schedule, ground = _schedule(body, end, durations, goal), FlatGround(friction=friction)
    leap = leaping.Leap(
        robot=body,
        start=body.reference[:3],
        end=end[:3],
        durations=durations,
        rise=takeoff.rise,
        turn=np.array([0.0, 0.0, chosen["yaw"]]),
    )
    base, lift = body.model.names[1], leaping.clearance(body, chosen["flight"])
    guess = legged_guess(body, schedule, leap.waypoints(), terrain=ground, clearance=lift)
    costs = goal_terms(
        goal,
        body,
        schedule,
        frame=body.model.names[1],
        effort=effort_costs(acceleration=leaping.ACCELERATION),
    )
    return Problem(
        name=f"{kind}-jump-{direction}",
        robot=body,
        schedule=schedule,
        terrain=ground,
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(
            *leaping.leap_terms(body, schedule, ground, guess, effort=effort, clearance=lift, costs=costs),
            *leaping.above_ground(body, dict.fromkeys(("stance", "flight", "landing"), 0.0)),
            FrameHeight(frame=base, height=body.reference[2] + chosen["height"], phase="flight"),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=guess,
        parameters=chosen,
        default_intervals=INTERVALS if goal == "effort" else FREE_INTERVALS,
    )


def _schedule(robot: Robot, end: np.ndarray, durations: tuple[float, float, float], goal: str) -> Schedule:
    """Stance, flight and landing, of free durations for least time."""
    schedule = common.hop_schedule(contact_positions(robot, end), durations)
    if goal == "effort":
        return schedule
    return Schedule(
        tuple(
            replace(phase, duration_bounds=(FREE[0] * phase.duration, FREE[1] * phase.duration))
            for phase in schedule.phases
        )
    )


def family(
    direction: Direction,
    summary: str,
    *,
    kind: str = "quadruped",
    robots: tuple[str, ...] = ROBOTS,
    load: Callable[[str], Robot] = leaping.quadruped,
) -> Family:
    """The family of jumps in a direction, on robots of a kind."""
    return Family(
        name=f"{kind}-jump-{direction}",
        robots=robots,
        phases=("stance", "flight", "landing"),
        summary=summary,
        parameters=(
            leaping.scaled("distance", "m", (-5.0, 5.0), "forward displacement"),
            leaping.scaled("sideways", "m", (-5.0, 5.0), "displacement to the left"),
            leaping.scaled("height", "m", (0.0, 5.0), "least rise of the base over standing in mid flight"),
            leaping.scaled("yaw", "rad", (-math.pi, math.pi), "turn to the left"),
            leaping.scaled("stance", "s", (1e-3, 10.0), "duration of the push"),
            leaping.scaled("flight", "s", (1e-3, 3.0), "duration of the flight (default: from the height)"),
            leaping.scaled("landing", "s", (1e-3, 10.0), "duration from touchdown to rest"),
            common.friction(0.7),
            common.effort(),
            common.goal("effort", "time"),
        ),
        build=partial(build, direction=direction, kind=kind, load=load),
    )


FAMILIES = (
    family("up", "jump straight up, land on the same places and come to rest"),
    family("forward", "jump forward from stance to stance"),
    family("sideways", "jump to the left from stance to stance"),
    family("turn", "jump up and turn to the left in flight"),
)
