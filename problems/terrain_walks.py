"""What walks of quadrupeds over terrain share: how far and how fast, schedules, terms, parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.family import Choice, Parameter
from trajopt.problem.problem import Problem
from trajopt.reduced.gait_guess import Pace
from trajopt.reduced.terrain_guess import plan_over_terrain
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import Legs, quadruped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.gait_transitions import transition
from trajopt.schedule.gaits import Gait
from trajopt.schedule.named_gaits import gait_of
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms import (
    FrictionPyramid,
    PositionLimits,
    Term,
    TerminalRest,
    TerminalState,
    TrackingCost,
    VelocityLimits,
    effort_costs,
    swing_arcs,
    swing_clearance,
)
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.terrain import Terrain
from trajopt_library import robots

from . import common
from .gait_common import CLEARANCE, STYLES, TRACKING

# Gaits without flights: there are always feet on the ground.
GAITS = ("trot", "walk")
INTERVALS_PER_PERIOD = 20
# Standing before the first and after the last swing, in periods of the gait.
STAND = 0.5
# Room between feet and edges at the start and at the end, and kept from edges, parts of the robot's length.
ROOM, MARGIN = 0.25, 0.05
MOST_CYCLES = 20


@dataclass(frozen=True, kw_only=True)
class Walker:
    """A quadruped that is to go over terrain: its ``gait``, and places (x, y) of its feet seen from above.

    ``lift``: height of swings, m; ``cycles``: periods of the gait, None: as many as the way needs.
    """

    robot: Robot
    legs: Legs
    style: str
    gait: Gait
    lift: float
    margin: float
    friction: float
    cycles: int | None

    @property
    def length(self) -> float:
        """Length of the robot, m."""
        return self.robot.length

    @property
    def stride(self) -> float:
        """Way of the base in a period at the gait's speed, m."""
        style = STYLES[self.style]
        return style.speed(self.robot) * self.period

    @property
    def period(self) -> float:
        """Period of the gait, s."""
        style = STYLES[self.style]
        return style.period(self.robot, style.speed(self.robot))

    @property
    def feet(self) -> dict[str, np.ndarray]:
        """Places (3,) of the feet in the reference posture, m, world."""
        found = contact_positions(self.robot, self.robot.reference)
        return {name: found[name] for name in self.gait.feet}

    @property
    def foremost(self) -> float:
        """Greatest x of a foot, m."""
        return max(float(place[0]) for place in self.feet.values())

    @property
    def edge(self) -> float:
        """Where terrain begins: x in m, some room before the fore feet."""
        return self.foremost + ROOM * self.length

    def way_across(self, extent: float) -> float:
        """Way in m that brings all feet from before terrain of that extent, m, to behind it."""
        hindmost = min(float(place[0]) for place in self.feet.values())
        return self.foremost - hindmost + extent + 2 * ROOM * self.length


def walker(
    *,
    robot: str,
    gait: str,
    cycles: float | None,
    clearance: float | None,
    margin: float | None,
    friction: float,
) -> Walker:
    """The robot and its gait with defaults filled in. Raises InputError."""
    if cycles is not None and cycles != round(cycles):
        raise InputError(f"parameter cycles is {cycles:g}", "allowed: a whole number")
    body = robots.load(robot)
    return Walker(
        robot=body,
        legs=quadruped_legs(body),
        style=gait,
        gait=gait_of(body, gait),
        lift=CLEARANCE * body.length if clearance is None else clearance,
        margin=MARGIN * body.length if margin is None else margin,
        friction=friction,
        cycles=None if cycles is None else round(cycles),
    )


def schedule_for(own: Walker, way: float) -> tuple[Schedule, Pace, int]:
    """Standing, cycles, standing, the pace that goes ``way`` m forward in them, and how many they are.

    The pace grows and falls over the first and the last period. Without a number of cycles the least whose
    strides at full pace are no longer than the gait's own.
    """
    counts = range(2, MOST_CYCLES + 1) if own.cycles is None else (own.cycles,)
    for cycles in counts:
        stand = STAND * own.period
        schedule = Schedule(transition(own.gait, own.period, cycles=cycles, stand=stand, rest=stand))
        whole = schedule.duration
        change = min(own.period + stand, whole / 2)
        unit = Pace(velocity=(1.0, 0.0), starts=(0.0, change), stops=(whole - change, whole))
        speed = way / unit.progress(whole)
        if own.cycles is not None or abs(speed) * own.period <= own.stride * (1 + 1e-9):
            return schedule, replace(unit, velocity=(speed, 0.0)), cycles
    raise InputError(
        f"a way of {way:.3g} m is more than {MOST_CYCLES} strides of {own.stride:.3g} m",
        "allowed: a shorter way",
    )


def problem_over(
    name: str,
    own: Walker,
    terrain: Terrain,
    way: float,
    *,
    footholds: str,
    effort_share: float,
    parameters: dict[str, object],
) -> Problem:
    """From standing to standing ``way`` m ahead over terrain. Raises InputError."""
    robot = own.robot
    schedule, pace, cycles = schedule_for(own, way)
    plan = plan_over_terrain(robot, schedule, pace, terrain, clearance=own.lift, free=footholds == "free")
    end = plan.guess(schedule.duration)
    return Problem(
        name=name,
        robot=robot,
        schedule=plan.schedule,
        terrain=terrain,
        initial_q=plan.start,
        initial_v=np.zeros(robot.nv),
        terms=(
            *effort_costs(),
            TrackingCost(reference=plan.guess, part="base", weight=TRACKING),
            common.share_of_effort(robot, effort_share),
            PositionLimits(),
            VelocityLimits(),
            FrictionPyramid(),
            *_swings(own, plan.schedule, terrain, plan.guess),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=plan.guess,
        parameters={
            "cycles": float(cycles),
            "clearance": own.lift,
            **parameters,
        },
        default_intervals=max(
            len(schedule.phases), math.ceil(INTERVALS_PER_PERIOD * schedule.duration / own.period)
        ),
    )


def _swings(own: Walker, schedule: Schedule, terrain: Terrain, guess: Motion) -> tuple[Term, ...]:
    """Arcs over the whole of every swing; over edges the swings that cut none."""
    if isinstance(terrain, PiecewiseTerrain):
        return swing_clearance(own.robot, schedule, terrain, height=own.lift, guess=guess)
    return swing_arcs(schedule, own.gait.feet, height=own.lift, terrain=terrain)


def parameters(*own: Parameter | Choice, margin: bool = True) -> tuple[Parameter | Choice, ...]:
    """Parameters of a family: its ``own``, then those that all share."""
    kept = common.length("margin", None, "kept from edges (default: 0.05 of the robot's length)", (0.0, 0.5))
    return (
        *own,
        Choice(name="gait", default=GAITS[0], choices=GAITS, meaning="which gait"),
        Choice(
            name="footholds",
            default="free",
            choices=("free", "planned"),
            meaning="anywhere on the face under planned places (the last one at its place), or at these",
        ),
        Parameter(
            name="cycles",
            default=None,
            unit="",
            lower=1.0,
            upper=float(MOST_CYCLES),
            meaning="periods of the gait (default: by the way and the gait's stride)",
        ),
        common.length(
            "clearance",
            None,
            "height of swings over the ground and over edges (default: 0.1 of the robot's length)",
            (0.0, 1.0),
        ),
        *((kept,) if margin else ()),
        common.friction(0.7),
        common.effort_share(),
    )
