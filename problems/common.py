"""Shared by all families: parameters, limits, paths of guesses, schedules, and the problem itself."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.problem import Choice, Parameter, Problem
from trajopt.reduced import hermite as hermite
from trajopt.robot import Robot, quadruped_legs
from trajopt.schedule import Motion, Phase, Schedule
from trajopt.terms import (
    AccelerationLimits,
    Actuation,
    JerkCost,
    JerkLimits,
    PositionLimits,
    Term,
    TerminalRest,
    TerminalState,
    TorqueLimits,
    TorqueRateLimits,
    VelocityLimits,
    contact_cones,
    effort_costs,
    swing_clearance,
)
from trajopt.terrain import FlatGround, Terrain
from trajopt_library import robots

# Least height of a foot above the ground in mid-flight, m.
CLEARANCE = 0.03
# Weight of impulses: without it, impacts brake at no cost, since torque costs do not include them.
IMPULSE_WEIGHT = 0.1
# Rounding error of a number of intervals.
WHOLE = 1e-9

Range = tuple[float, float]


def number(name: str, default: float | None, unit: str, meaning: str, within: Range) -> Parameter:
    """A number within bounds."""
    lower, upper = within
    return Parameter(name=name, default=default, unit=unit, lower=lower, upper=upper, meaning=meaning)


def duration(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """A time, s, within bounds."""
    return number(name, default, "s", meaning, within)


def length(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """A distance or a coordinate, m, within bounds."""
    return number(name, default, "m", meaning, within)


def angle(name: str, default: float | None, meaning: str, within: Range) -> Parameter:
    """An angle, rad, within bounds."""
    return number(name, default, "rad", meaning, within)


def speed(name: str, default: float | None, meaning: str) -> Parameter:
    """A commanded velocity of the base, m/s."""
    return number(name, default, "m/s", meaning, (-10.0, 10.0))


def share(name: str, default: float | None, meaning: str) -> Parameter:
    """A fraction of a period, neither none nor all of it."""
    return number(name, default, "", meaning, (0.05, 0.95))


def friction(default: float, name: str = "friction", meaning: str = "friction coefficient") -> Parameter:
    """A coefficient of friction."""
    return number(name, default, "", meaning, (0.0, 10.0))


def hop_durations(
    flight: str, defaults: tuple[float | None, ...] = (None, None, None), longest: float = 3.0
) -> tuple[Parameter, ...]:
    """Durations of stance, flight and landing, s; ``flight`` says how that of the flight is derived."""
    return (
        duration("stance", defaults[0], "duration of the push", (1e-3, 10.0)),
        duration("flight", defaults[1], f"duration of the flight (default: {flight})", (1e-3, longest)),
        duration("landing", defaults[2], "duration from touchdown to rest", (1e-3, 10.0)),
    )


def choice(name: str, meaning: str, *choices: str) -> Choice:
    """One of several words; the first is the default."""
    return Choice(name=name, default=choices[0], choices=choices, meaning=meaning)


def goal(*choices: str, meaning: str = "objective") -> Choice:
    """The objective: names in `trajopt.terms.objectives`, the first is the default."""
    return choice("goal", meaning, *choices)


# One torque limit for all joints; default: the robot's own limits.
TORQUE_LIMIT = number("torque_limit", None, "N m", "torque limit (default: the URDF's)", (0.0, 1e4))
TORQUE_SHARE = number("torque_share", 1.0, "", "usable fraction of the torque limits", (1e-3, 1.0))
# The control input. With jerks, accelerations are continuous, and zero at rest.
ACTUATION = choice(
    "actuation", "control input: torques, or jerks within the robot's limits", "torque", "jerk"
)
# Weights of jerks, which give every direction of the motion a cost, by the goal.
SMOOTH_JERK = {"effort": 1e-4, "time": 1e-5}
# With a moving base rows hold at nodes, where contacts would ring; the degree is twice that of most problems.
JERK_SCHEME, JERK_INTERVALS = "radau:4", 0.5
# Kind of touchdown: `hop_schedule` takes ``impact``, which needs a cost on impulses.
TOUCHDOWN = choice("touchdown", "land at zero foot velocity or by a rigid impact", "soft", "impact")


def filled(defaults: Mapping[str, float], given: Mapping[str, float | None]) -> dict[str, float]:
    """Values of parameters: the given ones, and defaults for those that are None."""
    return {**defaults, **{name: value for name, value in given.items() if value is not None}}


def whole(name: str, value: float) -> int:
    """The value of a parameter that counts something. Raises InputError."""
    if value != round(value):
        raise InputError(f"parameter {name} is {value:g}", "allowed: a whole number")
    return round(value)


def quadruped(name: str | Robot) -> Robot:
    """The robot of that name. Raises InputError if it does not stand on four feet."""
    robot = robots.load(name)
    quadruped_legs(robot)
    return robot


def foot_radius(robot: Robot) -> float:
    """Largest radius of the robot's contacts, m."""
    return max((contact.radius for contact in robot.contacts), default=0.0)


def displaced(
    robot: Robot, position: np.ndarray | tuple[float, float, float], yaw: float = 0.0
) -> np.ndarray:
    """Reference posture (nq,) with the base moved by ``position`` (3,) m and turned by ``yaw`` rad."""
    q = robot.reference.copy()
    q[:3] += position
    turn = pin.utils.rotate("z", yaw) @ pin.Quaternion(q[3:7]).toRotationMatrix()
    q[3:7] = pin.Quaternion(turn).coeffs()
    return q


def intervals(wanted: float) -> int:
    """Least number of intervals that is ``wanted`` or more; rounding errors do not add one."""
    return math.ceil(wanted - WHOLE)


def hop_schedule(
    footholds: Mapping[str, np.ndarray], durations: tuple[float, float, float], *, impact: bool = False
) -> Schedule:
    """Stance, flight and landing: contacts leave together and land on ``footholds`` (3,) m, world."""
    feet = tuple(footholds)
    named = dict(zip(("stance", "flight", "landing"), durations, strict=True))
    *before, landing = schedule_of(named, (feet, (), feet), footholds).phases
    return Schedule((*before, replace(landing, impact=impact)))


def schedule_of(
    durations: Mapping[str, float],
    contacts: Sequence[tuple[str, ...]],
    footholds: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> Schedule:
    """Phases of ``durations`` s by name on these contacts, which land on ``footholds`` (3,) m, world."""
    phases, before = [], contacts[0]
    for (name, time), on in zip(durations.items(), contacts, strict=True):
        landing = {foot: footholds[foot] for foot in on if foot not in before}
        phases.append(Phase(name=name, duration=time, contacts=on, footholds=landing))
        before = on
    return Schedule(tuple(phases))


def freed(schedule: Schedule, *within: Range) -> Schedule:
    """The schedule with free durations, within multiples of the nominal ones: for each phase, or for all."""
    bounds = within * len(schedule.phases) if len(within) == 1 else within
    return Schedule(
        tuple(
            replace(phase, duration_bounds=(low * phase.duration, high * phase.duration))
            for phase, (low, high) in zip(schedule.phases, bounds, strict=True)
        )
    )


def torque_limits(
    robot: Robot, torque_limit: float | None = None, torque_share: float | None = None
) -> TorqueLimits:
    """Torque limits of ``torque_limit`` N m for all joints, or a share of the robot's; None: the robot's."""
    if torque_limit is not None:
        return TorqueLimits(limit=np.full(robot.nu, torque_limit))
    if torque_share is None or robot.torque_limit is None:
        return TorqueLimits()
    return TorqueLimits(limit=torque_share * robot.torque_limit)


def jerk_terms(robot: Robot, goal: str) -> tuple[Term, ...]:
    """Limits of accelerations, jerks and torque rates that the robot has, and a small cost on jerks."""
    limits = (AccelerationLimits(), JerkLimits(), TorqueRateLimits())
    limited = [term for term in limits if np.isfinite(robot.joint_limit(term.kind)).any()]
    return (*limited, JerkCost(weight=SMOOTH_JERK[goal]))


def problem(
    name: str,
    robot: Robot,
    schedule: Schedule,
    guess: Motion,
    *,
    costs: Sequence[Term] | None = None,
    end: np.ndarray | Sequence[Term],
    torques: Term | None = None,
    cones: Sequence[Term] | None = None,
    torque_limit: float | None = None,
    torque_share: float | None = None,
    terrain: Terrain | None = None,
    friction: float = 0.7,
    clearance: float | None = None,
    more: Sequence[Term] = (),
    initial_q: np.ndarray | None = None,
    initial_v: np.ndarray | None = None,
    actuation: Actuation = "torque",
    goal: str = "effort",
    **settings: Any,
) -> Problem:
    """A motion with costs and all limits, by default from rest in the reference posture on level ground.

    Args:
        name: of the problem.
        robot: of the problem.
        schedule: of the problem.
        guess: t -> (nq,), s.
        costs: default `effort_costs`.
        end: a configuration (nq,) to end in at rest, or terms.
        torques: torque limits, default those of `torque_limits`; only with torque as control input.
        torque_limit: see `torque_limits`.
        torque_share: see `torque_limits`.
        cones: friction terms, default `contact_cones`.
        terrain: default level ground with the coefficient ``friction``.
        friction: of the default terrain.
        clearance: of swing feet over the terrain in mid swing, m, or None.
        more: further terms.
        initial_q: (nq,), default the reference.
        initial_v: (nv,), default rest.
        actuation: the control input; jerks get `jerk_terms` and, with a moving base, `JERK_SCHEME`.
        goal: the objective, for the weight of jerks.
        settings: other fields of `Problem`.
    """
    ground = FlatGround(friction=friction) if terrain is None else terrain
    running = effort_costs() if costs is None else costs
    if torques is None:
        torques = torque_limits(robot, torque_limit, torque_share)
    limits = (torques,) if actuation in ("torque", "jerk") else ()
    if actuation == "jerk":
        more = (*more, *jerk_terms(robot, goal))
        if robot.base != "fixed":
            settings["default_transcription"] = JERK_SCHEME
            settings["default_intervals"] = intervals(JERK_INTERVALS * settings["default_intervals"])
    swings: tuple[Term, ...] = ()
    if clearance is not None:
        swings = swing_clearance(robot, schedule, ground, height=clearance, guess=guess)
    touching = contact_cones(robot.contacts) if cones is None else cones
    arrival = (TerminalState(q=end), TerminalRest(q=end)) if isinstance(end, np.ndarray) else end
    return Problem(
        name=name,
        robot=robot,
        schedule=schedule,
        terrain=ground,
        initial_q=robot.reference if initial_q is None else initial_q,
        initial_v=np.zeros(robot.nv) if initial_v is None else initial_v,
        terms=(*running, *limits, PositionLimits(), VelocityLimits(), *touching, *swings, *more, *arrival),
        guess=guess,
        actuation=actuation,
        **settings,
    )


def wall_normal(tilt: float) -> np.ndarray:
    """Normal (3,) of a wall ahead, towards the robot; a positive ``tilt`` rad turns the wall's top away."""
    return np.array([-math.cos(tilt), 0.0, math.sin(tilt)])
