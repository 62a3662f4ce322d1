"""A biped walks: weight shift, steps with a smooth swing and double support between, rest with feet level.

The guess is the walk of the linear inverted pendulum over the same footsteps; it needs soles, because the
pendulum's zero-moment point cannot move while one point foot stands.
"""

import math
from dataclasses import replace

from trajopt.problem import Family, Parameter, Problem
from trajopt.reduced import Walk
from trajopt.robot import Robot, require_soles, with_edges
from trajopt.schedule import Motion, Schedule, footholds_at, placed_on, rolled
from trajopt.terms import Term, TerminalRest, swing_arcs
from trajopt.terrain import FlatGround

from . import bipeds, common

# Swing height of the guess over the required one.
GUESS_SWING = 1.5
# Length in m of Talos, for which the defaults are given. Other robots walk at the same Froude number: lengths
# are in proportion to theirs, times to its square root.
LENGTH_OF_DEFAULTS = 1.0193317172808651
LENGTHS = {"length": 0.2, "clearance": 0.04}
TIMES = {"step_time": 0.6, "double_support": 0.15, "shift": 0.5, "settle": 0.6}
# Intervals per second, for Talos.
INTERVALS_PER_SECOND = 10
# Range of the duration of each part of the walk, s.
DURATIONS = (0.05, 5.0)


def _rolling(
    robot: Robot, flat: Schedule, guess: Motion, rolls: tuple[float, float], clearance: float
) -> tuple[Robot, Schedule, tuple[Term, ...]]:
    """Return robot, schedule and swing terms for rolling soles; corners land as in the guess."""
    free = Schedule(tuple(replace(phase, footholds={}) for phase in flat.phases))
    soles = [contact.name for contact in robot.contacts]
    robot, free = with_edges(robot), rolled(free, soles, heel=rolls[0], toe=rolls[1])
    phases, time, ground = [], 0.0, FlatGround()
    for index, phase in enumerate(free.phases):
        places = footholds_at(robot, guess(time))
        landing = {name: places[name] for name in free.new_contacts(index)}
        phases.append(replace(phase, footholds=landing))
        time += phase.duration
    corners = tuple(contact.name for contact in robot.contacts)
    arcs = swing_arcs(free, corners, height=clearance, terrain=ground)
    return robot, placed_on(Schedule(tuple(phases)), ground), arcs


def build(
    *,
    robot: str,
    steps: float,
    turn: float,
    feet: str,
    heel: float | None,
    toe: float | None,
    friction: float,
    torque_share: float,
    **given: float | None,
) -> Problem:
    """Build the walk; see ``FAMILY`` for the parameters. Raises InputError."""
    count, body = common.whole("steps", steps), bipeds.biped(robot)
    require_soles(body)
    rolls = bipeds.rolls_of(body, feet, heel, toe)
    scale = body.length / LENGTH_OF_DEFAULTS
    values = {name: value * scale for name, value in LENGTHS.items()}
    values |= {name: value * math.sqrt(scale) for name, value in TIMES.items()}
    values = common.filled(values, given)
    walk = Walk(
        steps=count,
        length=values["length"],
        turn=turn,
        step_time=values["step_time"],
        double_support=values["double_support"],
        shift_time=values["shift"],
        settle_time=values["settle"],
    )
    plan = walk.plan(body)
    from trajopt.reduced import guess_from_lip  # slow; not needed to list problems

    guess = guess_from_lip(body, plan, clearance=GUESS_SWING * values["clearance"])
    intervals = common.intervals(INTERVALS_PER_SECOND * plan.duration / math.sqrt(scale))
    schedule, lift = plan.schedule(body), values["clearance"]
    arcs: tuple[Term, ...] = ()
    if rolls is not None:
        body, schedule, arcs = _rolling(body, schedule, guess, rolls, lift)
    return common.problem(
        "biped-walk",
        body,
        schedule,
        guess,
        torque_share=torque_share,
        friction=friction,
        clearance=lift if rolls is None else None,
        more=arcs,
        end=(TerminalRest(q=guess(plan.duration)),),
        parameters=values | {"steps": walk.steps},
        default_intervals=max(len(schedule.phases), intervals),
    )


def _time(name: str, meaning: str) -> Parameter:
    described = f"{meaning} (default: {TIMES[name]:g} s on Talos, scaled by sqrt(length))"
    return common.duration(name, None, f"duration {described}", DURATIONS)


def _way(name: str, meaning: str, within: common.Range) -> Parameter:
    described = f"{meaning} (default: {LENGTHS[name]:g} m on Talos, scaled by length)"
    return common.length(name, None, described, within)


FAMILY = Family(
    name="biped-walk",
    robots=("talos", "g1"),
    phases=("shift", "step_1", "double_1", "step_2", "...", "settle"),
    summary="walk some steps on two soles, bring the feet side by side and come to rest",
    parameters=(
        common.number("steps", 4, "", "number of steps", (2, 20)),
        _way("length", "step length", (-0.4, 0.4)),
        common.angle("turn", 0.0, "turn to the left per step", (-0.4, 0.4)),
        _time("step_time", "of a swing"),
        _time("double_support", "of double support between steps"),
        _time("shift", "from rest to the first step"),
        _time("settle", "from the last touchdown to rest"),
        _way("clearance", "least height of a sole in mid swing", (0.0, 0.2)),
        *bipeds.ROLLING,
        common.friction(0.7),
        common.TORQUE_SHARE,
    ),
    build=build,
)
