"""A biped squats: down on both feet and up again, from rest to rest."""

from __future__ import annotations

import numpy as np

from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.reduced.legged_guess import legged_guess
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import FrameHeight, TerminalRest, TerminalState
from trajopt.terrain.flat import FlatGround

from . import bipeds, common, leaping

# Depth as a part of the robot's length; duration in units of sqrt(l / g): two seconds for a human's leg.
DEPTH, DURATION = 0.2, 6.0
INTERVALS = 30


def build(
    *, robot: str, depth: float | None, duration: float | None, friction: float, effort_share: float
) -> Problem:
    """Build the squat; see ``FAMILY`` for the parameters. Raises InputError."""
    body = bipeds.biped(robot)
    if depth is None:
        depth = min(DEPTH * body.length, leaping.OF_REACHABLE * leaping.sink_left(body))
    duration = DURATION * leaping.natural_time(body) if duration is None else duration
    feet = tuple(contact.name for contact in body.contacts)
    schedule = Schedule((Phase(name="squat", duration=duration, contacts=feet),))
    down = (0.0, 0.0, -depth)
    path = [
        bipeds.waypoint(body, time, shift)
        for time, shift in ((0.0, (0.0, 0.0, 0.0)), (duration / 2, down), (duration, (0.0, 0.0, 0.0)))
    ]
    return Problem(
        name="biped-squat",
        robot=body,
        schedule=schedule,
        terrain=FlatGround(friction=friction),
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(
            *common.legged_costs(acceleration=bipeds.ACCELERATION),
            *bipeds.limits(body, effort_share),
            FrameHeight(
                frame=body.model.names[1], height=body.reference[2] - depth, phase="squat", below=True
            ),
            TerminalState(q=body.reference),
            TerminalRest(q=body.reference),
        ),
        guess=legged_guess(body, schedule, path),
        parameters={"depth": depth, "duration": duration},
        default_intervals=INTERVALS,
    )


FAMILY = Family(
    name="biped-squat",
    robots=bipeds.ROBOTS,
    phases=("squat",),
    summary="sink by a depth on both feet and rise again, from rest to rest",
    parameters=(
        Parameter(
            name="depth",
            default=None,
            unit="m",
            lower=0.0,
            upper=2.0,
            meaning="least depth of the base (default: 0.2 of the length, less where joints end)",
        ),
        common.duration("duration", None, "of the whole (default: by the robot's length)", (0.05, 60.0)),
        common.friction(0.7),
        common.effort_share(),
    ),
    build=build,
)
