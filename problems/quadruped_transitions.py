"""Quadrupeds start a gait from a stance, stop one, or do both.

A gait begins and ends in its commanded state, at a touchdown: the base level at standing height over the
commanded path at the commanded speed, feet where they are planned. The end of one start is the beginning of
the same gait's stop.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from trajopt.problem import Choice, Family, Problem
from trajopt.reduced import GaitPlan, Pace, plan_of_part
from trajopt.robot import Robot
from trajopt.schedule import QUADRUPED, Phase, Schedule, gait_of, transition
from trajopt.terms import TerminalRest, TerminalState, TerminalVelocity, swing_arcs
from trajopt.terrain import FlatGround

from . import common, gait_common
from .gait_common import HIGHER, ROBOTS, STYLES, gait_costs

# Intervals per period of the gait, also while standing.
INTERVALS_PER_PERIOD = 20

STARTS = {"start": True, "stop": False, "go": True}
STOPS = {"start": False, "stop": True, "go": True}


def _pace(steady: Pace, kind: str, phases: tuple[Phase, ...], period: float) -> Pace:
    """Return a pace that is full in the last period of a start, or in the first period of a stop.

    Where a start and a stop meet, the gait then moves as in its periodic cycle, with the same state.
    """
    duration = sum(phase.duration for phase in phases)
    grown, falling = duration - period, period
    if kind == "go":
        grown = falling = duration / 2
    return Pace(
        velocity=steady.velocity,
        turn_rate=steady.turn_rate,
        starts=(0.0, grown) if STARTS[kind] else None,
        stops=(falling, duration) if STOPS[kind] else None,
    )


def build(
    *,
    kind: str,
    robot: str,
    gait: str,
    cycles: float,
    stand: float | None,
    goal: str,
    friction: float,
    torque_share: float,
    **commanded: Any,
) -> Problem:
    """Build a start, a stop or both; see ``FAMILIES`` for the parameters. Raises InputError."""
    count, body = common.whole("cycles", cycles), common.quadruped(robot)
    asked = gait_common.command(body, STYLES[gait], gait_of(body, gait), **commanded)
    time = 0.5 * asked.period if stand is None else stand

    def phases(cycles: int) -> tuple[Phase, ...]:
        return transition(
            asked.gait,
            asked.period,
            cycles=cycles,
            stand=time if STARTS[kind] else None,
            rest=time if STOPS[kind] else None,
        )

    part = phases(count)
    whole = part if kind == "go" else phases(count + 1)
    pace = _pace(asked.pace, kind, part, asked.period)
    first = len(whole) - len(part) if kind == "stop" else 0
    plan = plan_of_part(body, Schedule(part), Schedule(whole), first, pace, clearance=HIGHER * asked.lift)
    held = replace(plan.schedule.phases[0], footholds={})  # these contacts stay where they are at the start
    schedule = Schedule((held, *plan.schedule.phases[1:]))
    begin, end = _ends(body, kind, plan, whole)
    ending = TerminalRest(q=end[0]) if STOPS[kind] else TerminalVelocity(q=end[0], v=end[1])
    return common.problem(
        f"quadruped-{kind}",
        body,
        schedule,
        plan.guess,
        costs=gait_costs(goal, body, schedule, pace),
        torque_share=torque_share,
        friction=friction,
        more=swing_arcs(schedule, asked.gait.feet, height=asked.lift, terrain=FlatGround()),
        end=(TerminalState(q=end[0]), ending),
        initial_q=begin[0],
        initial_v=begin[1],
        parameters=asked.parameters | {"stand": time},
        default_intervals=max(
            len(part), common.intervals(INTERVALS_PER_PERIOD * schedule.duration / asked.period)
        ),
    )


def _ends(
    robot: Robot, kind: str, plan: GaitPlan, whole: tuple[Phase, ...]
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the states (nq,), (nv,) at both ends: at rest, or those of the commanded gait."""
    part = plan.schedule.phases
    begin = robot.reference, np.zeros(robot.nv)
    if not STARTS[kind]:
        before = whole[len(whole) - len(part) - 1]
        begin = plan.state(robot, 0.0, sorted({*before.contacts, *part[0].contacts}))
    end = plan.guess(plan.schedule.duration), np.zeros(robot.nv)
    if not STOPS[kind]:
        after = whole[len(part)]
        end = plan.state(robot, plan.schedule.duration, sorted({*part[-1].contacts, *after.contacts}))
    return begin, end


_SUMMARIES = {
    "start": "from a stance into a gait, ending in the gait's commanded state",
    "stop": "from a gait's commanded state to a stance",
    "go": "from a stance through some cycles of a gait to a stance",
}
# One period to change speed and one at full speed; or one period to speed up and one to slow down.
LEAST_CYCLES = 2


def _family(kind: str) -> Family:
    stand, rest = (0.5 if has[kind] else None for has in (STARTS, STOPS))
    example = transition(QUADRUPED["trot"], 1.0, cycles=2, stand=stand, rest=rest)
    return Family(
        name=f"quadruped-{kind}",
        robots=ROBOTS,
        phases=tuple(phase.name for phase in example),
        summary=f"{kind}: {_SUMMARIES[kind]}",
        parameters=(
            Choice(name="gait", default="trot", choices=tuple(STYLES), meaning="name of the gait"),
            common.number("cycles", 2.0, "", "number of gait periods", (LEAST_CYCLES, 20.0)),
            common.duration(
                "stand", None, "duration of standing on all feet (default: half a period)", (0.01, 10.0)
            ),
            common.speed("speed", None, "forward speed at full pace (default: the gait's)"),
            common.speed("lateral", 0.0, "speed to the left at full pace"),
            gait_common.TURN_RATE,
            gait_common.PERIOD,
            gait_common.duty(),
            gait_common.GOAL,
            gait_common.clearance(),
            common.friction(0.7),
            common.TORQUE_SHARE,
        ),
        build=partial(build, kind=kind),
    )


FAMILIES = tuple(_family(kind) for kind in _SUMMARIES)
