"""A biped squats: down on both feet and up again, from rest to rest."""

from typing import Any

from trajopt.problem import Family, Problem
from trajopt.reduced import legged_guess
from trajopt.robot import Units
from trajopt.schedule import Phase, Schedule, middle_of
from trajopt.terms import FrameHeight

from . import bipeds, common, pushing

# Depth over the robot's length; duration in units of sqrt(l / g), two seconds for a human leg.
DEPTH, DURATION = 0.2, 6.0
INTERVALS = 30


def build(*, robot: str, depth: float | None, duration: float | None, **limits: Any) -> Problem:
    """Build the squat; see ``FAMILY`` for the parameters. Raises InputError."""
    body = bipeds.biped(robot)
    if depth is None:
        depth = min(DEPTH * body.length, pushing.OF_REACHABLE * pushing.sink_left(body))
    duration = DURATION * Units(body).time if duration is None else duration
    feet = tuple(contact.name for contact in body.contacts)
    schedule = Schedule((Phase(name="squat", duration=duration, contacts=feet),))
    down = (0.0, 0.0, -depth)
    path = [
        bipeds.waypoint(body, time, shift)
        for time, shift in ((0.0, (0.0, 0.0, 0.0)), (duration / 2, down), (duration, (0.0, 0.0, 0.0)))
    ]
    deepest = FrameHeight(
        frame=body.model.names[1], height=body.reference[2] - depth, at=middle_of("squat"), below=True
    )
    return common.problem(
        "biped-squat",
        body,
        schedule,
        legged_guess(body, schedule, path),
        more=(deepest,),
        end=body.reference,
        parameters={"depth": depth, "duration": duration},
        default_intervals=INTERVALS,
        **limits,
    )


FAMILY = Family(
    name="biped-squat",
    robots=bipeds.ROBOTS,
    phases=("squat",),
    summary="squat on both feet and rise again, from rest to rest",
    parameters=(
        common.length(
            "depth",
            None,
            "least descent of the base (default: 0.2 of the length, less at joint limits)",
            (0.0, 2.0),
        ),
        common.duration("duration", None, "total duration (default: from the robot's length)", (0.05, 60.0)),
        common.friction(0.7),
        common.TORQUE_SHARE,
        common.ACTUATION,
    ),
    build=build,
    variants={"actuation=jerk": bipeds.ROBOTS},
)
