"""Gaits of bipeds as periodic orbits at a commanded speed: half a cycle, closed by its mirror image."""

from __future__ import annotations

from functools import partial

import numpy as np

from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.periodicity import Periodicity
from trajopt.problem.problem import Problem
from trajopt.reduced.gait_guess import Pace, commanded_motion, plan_of_cycle
from trajopt.robot.legs import biped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.named_gaits import BIPED, gait_of
from trajopt.schedule.schedule import Schedule
from trajopt.terms import Term, swing_arcs
from trajopt.terrain.flat import FlatGround

from . import bipeds, common
from .gait_common import Style

# Froude numbers of a slow walk and of a jog; stride lengths follow from them as of other animals.
STYLES = {
    "walk": Style(froude=0.04, summary="a foot or two on the ground, double support between"),
    "run": Style(froude=0.25, summary="a foot or none on the ground"),
}
# Least height of a foot in mid swing, and that of the guess, as parts of the robot's length.
CLEARANCE = 0.05
GUESS_CLEARANCE = 0.08
# Over half a cycle.
INTERVALS = 16


def _terms(robot: Robot, pace: Pace, effort_share: float) -> tuple[Term, ...]:
    return (
        *common.legged_costs(acceleration=bipeds.ACCELERATION),
        bipeds.near(commanded_motion(robot, pace)),
        *bipeds.limits(robot, effort_share),
    )


def build(
    *,
    style: str,
    name: str,
    robot: str,
    speed: float | None,
    period: float | None,
    duty: float | None,
    cycle: str,
    clearance: float | None,
    friction: float,
    effort_share: float,
) -> Problem:
    """Build one periodic gait; see ``FAMILIES`` for the parameters. Raises InputError."""
    body, own = bipeds.biped(robot), STYLES[style]
    left, right = biped_legs(body)
    gait = gait_of(body, style)
    gait = gait if duty is None else gait.with_duty(duty)
    speed = own.speed(body) if speed is None else speed
    period = own.period(body, speed) if period is None else period
    lift = CLEARANCE * body.length if clearance is None else clearance
    pace, ground = Pace(velocity=(speed, 0.0)), FlatGround(friction=friction)
    half = cycle == "half"
    mirror = {left: right, right: left} if half else None
    schedule = Schedule(gait.phases(period) if mirror is None else gait.half_cycle(period, mirror))
    swing_up = lift * GUESS_CLEARANCE / CLEARANCE
    return Problem(
        name=name,
        robot=body,
        schedule=schedule,
        terrain=ground,
        initial_q=body.reference,
        initial_v=np.zeros(body.nv),
        terms=(
            *_terms(body, pace, effort_share),
            *swing_arcs(
                schedule,
                gait.feet,
                height=lift,
                terrain=ground,
                next_name=mirror or {foot: foot for foot in gait.feet},
            ),
        ),
        guess=plan_of_cycle(body, schedule, pace, mirror=mirror, clearance=swing_up).guess,
        parameters={"speed": speed, "period": period, "clearance": lift},
        default_intervals=INTERVALS if half else 2 * INTERVALS,
        periodicity=Periodicity(velocity=(speed, 0.0, 0.0), mirror=half),
    )


def _family(name: str, style: str) -> Family:
    own, gait = STYLES[style], BIPED[style]
    duty = gait.duty_of(gait.feet[0])
    return Family(
        name=name,
        robots=bipeds.ROBOTS,
        phases=("double_1", "single_1") if duty > 1 / 2 else ("single_1", "flight_1"),
        summary=f"{style}, periodic at a commanded speed: {own.summary}",
        parameters=(
            Parameter(
                name="speed",
                default=None,
                unit="m/s",
                lower=-10.0,
                upper=10.0,
                meaning=f"forward (default: Froude number {own.froude:g})",
            ),
            common.duration(
                "period", None, "of a cycle, two steps (default: by length and speed)", (0.05, 10)
            ),
            Parameter(
                name="duty",
                default=None,
                unit="",
                lower=0.05,
                upper=0.95,
                meaning=f"stance of a foot as part of the period (default: {duty:g})",
            ),
            Choice(
                name="cycle",
                default="half",
                choices=("half", "full"),
                meaning="solve one step, whose mirror image is the next, or both",
            ),
            Parameter(
                name="clearance",
                default=None,
                unit="m",
                lower=0.0,
                upper=1.0,
                meaning="least height of a foot in mid swing (default: a twentieth of the robot's length)",
            ),
            common.friction(0.7),
            common.effort_share(),
        ),
        build=partial(build, style=style, name=name),
    )


FAMILIES = (_family("biped-gait", "walk"), _family("biped-run", "run"))
