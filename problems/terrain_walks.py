"""Shared by the walks over terrain: distance and speed, schedules, terms, parameters."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.problem import Choice, Parameter, Problem
from trajopt.reduced import Pace, plan_over_terrain
from trajopt.robot import Robot, contact_positions
from trajopt.schedule import Schedule, gait_of, transition
from trajopt.terms import Term, effort_costs, swing_arcs
from trajopt.terrain import PiecewiseTerrain, Terrain

from . import common
from .gait_common import STYLES, Command, command, near

# Gaits without flight phases.
GAITS = ("trot", "walk")
INTERVALS_PER_PERIOD = 20
# Time standing before the first and after the last swing, in periods of the gait.
STAND = 0.5
# Distance of feet from edges at start and end, and margin that landings keep from edges, over the length.
ROOM, MARGIN = 0.25, 0.05
MOST_CYCLES = 20


@dataclass(frozen=True, kw_only=True)
class Walker:
    """A quadruped that walks over terrain in the gait ``asked``; positions of its feet.

    ``cycles``: periods of the gait, None: as many as the distance needs.
    """

    robot: Robot
    asked: Command
    margin: float
    friction: float
    cycles: int | None

    @property
    def length(self) -> float:
        """Length of the robot, m."""
        return self.robot.length

    @property
    def stride(self) -> float:
        """Distance of the base in a period at the gait's speed, m."""
        return self.asked.pace.velocity[0] * self.asked.period

    @property
    def feet(self) -> dict[str, np.ndarray]:
        """Positions (3,) of the feet in the reference posture, m, world."""
        places = contact_positions(self.robot, self.robot.reference)
        return {name: places[name] for name in self.asked.gait.feet}

    @property
    def foremost(self) -> float:
        """Greatest x of a foot, m."""
        return max(float(place[0]) for place in self.feet.values())

    @property
    def edge(self) -> float:
        """Where terrain begins: x in m, some room before the fore feet."""
        return self.foremost + ROOM * self.length

    @property
    def placed(self) -> dict[str, Any]:
        """Where terrain begins (x, y) in m, its friction, and the margin that feet keep from its edges, m."""
        return {"at": (self.edge, 0.0), "friction": self.friction, "margin": self.margin}

    def way_across(self, extent: float) -> float:
        """Distance in m that brings all feet across terrain of that extent, m."""
        hindmost = min(float(place[0]) for place in self.feet.values())
        return self.foremost - hindmost + extent + 2 * ROOM * self.length


def walker(
    *,
    robot: str,
    gait: str,
    cycles: float | None,
    clearance: float | None,
    friction: float,
    margin: float | None = None,
) -> Walker:
    """The robot and its gait with defaults filled in. Raises InputError."""
    count = None if cycles is None else common.whole("cycles", cycles)
    body = common.quadruped(robot)
    return Walker(
        robot=body,
        asked=command(body, STYLES[gait], gait_of(body, gait), clearance=clearance),
        margin=max(MARGIN * body.length, common.foot_radius(body)) if margin is None else margin,
        friction=friction,
        cycles=count,
    )


def schedule_for(walker: Walker, way: float) -> tuple[Schedule, Pace, int]:
    """Standing, cycles, standing; the pace that moves ``way`` m forward; and the number of cycles.

    The pace rises over the first period and falls over the last. By default the number of cycles is the least
    for which strides at full pace are no longer than the gait's.
    """
    counts = range(2, MOST_CYCLES + 1) if walker.cycles is None else (walker.cycles,)
    gait, period = walker.asked.gait, walker.asked.period
    for cycles in counts:
        stand = STAND * period
        schedule = Schedule(transition(gait, period, cycles=cycles, stand=stand, rest=stand))
        whole = schedule.duration
        change = min(period + stand, whole / 2)
        unit = Pace(velocity=(1.0, 0.0), starts=(0.0, change), stops=(whole - change, whole))
        speed = way / unit.progress(whole)
        if walker.cycles is not None or abs(speed) * period <= walker.stride * (1 + 1e-9):
            return schedule, replace(unit, velocity=(speed, 0.0)), cycles
    raise InputError(
        f"a distance of {way:.3g} m is more than {MOST_CYCLES} strides of {walker.stride:.3g} m",
        "allowed: a shorter distance",
    )


def problem_over(
    name: str,
    walker: Walker,
    terrain: Terrain,
    way: float,
    *,
    footholds: str,
    torque_share: float,
    parameters: dict[str, Any],
) -> Problem:
    """From standing to standing ``way`` m ahead over terrain. Raises InputError."""
    robot, lift = walker.robot, walker.asked.lift
    schedule, pace, cycles = schedule_for(walker, way)
    plan = plan_over_terrain(robot, schedule, pace, terrain, clearance=lift, free=footholds == "free")
    arcs: tuple[Term, ...] = ()  # terrain with edges has `SwingOver` instead of arcs over whole swings
    if not isinstance(terrain, PiecewiseTerrain):
        arcs = swing_arcs(plan.schedule, walker.asked.gait.feet, height=lift, terrain=terrain)
    return common.problem(
        name,
        robot,
        plan.schedule,
        plan.guess,
        costs=(*effort_costs(), near(plan.guess)),
        torque_share=torque_share,
        terrain=terrain,
        clearance=None if arcs else lift,
        more=arcs,
        end=plan.guess(schedule.duration),
        initial_q=plan.start,
        parameters={"cycles": float(cycles), "clearance": lift, **parameters},
        default_intervals=max(
            len(schedule.phases),
            common.intervals(INTERVALS_PER_PERIOD * schedule.duration / walker.asked.period),
        ),
    )


def parameters(*first: Parameter | Choice, margin: bool = True) -> tuple[Parameter | Choice, ...]:
    """Parameters of a family: the ``first`` ones, then those that all share."""
    kept = common.length(
        "margin",
        None,
        "distance kept from edges (default: 0.05 of the length or a foot's radius)",
        (0.0, 0.5),
    )
    return (
        *first,
        common.choice("gait", "name of the gait", *GAITS),
        common.choice(
            "footholds",
            "feet land anywhere on the planned face (at last as planned), or on planned footholds",
            "free",
            "planned",
        ),
        common.number(
            "cycles",
            None,
            "",
            "number of gait periods (default: from distance and stride)",
            (1.0, float(MOST_CYCLES)),
        ),
        common.length(
            "clearance",
            None,
            "height of swings over the ground and over edges (default: 0.1 of the robot's length)",
            (0.0, 1.0),
        ),
        *((kept,) if margin else ()),
        common.friction(0.7),
        common.TORQUE_SHARE,
    )
