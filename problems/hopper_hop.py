"""A hop on one leg: onto a foothold, as high or as far as possible, of a hopper in the plane or in space.

In minimal coordinates of each phase or as one floating-base system.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajopt.dynamics.model_quantities import gravity_of
from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import stance_mode
from trajopt.schedule.schedule import Schedule
from trajopt.terms import (
    EffortLimits,
    FrictionPyramid,
    ImpulseCost,
    NodeConstraint,
    PositionLimits,
    SwingClearance,
    Term,
    TerminalPosture,
    TerminalRest,
    TerminalState,
    VelocityLimits,
    effort_costs,
    goal_terms,
)
from trajopt.terrain.flat import FlatGround

from . import common, hoppers

# The base rises by this part of the robot's length while the leg stretches, in the guess.
RISE = 0.17
# Durations that are free, for every goal but effort, are between these parts of the nominal ones: time on the
# ground is for one push, a flight may be long.
FREE, FREE_FLIGHT = (0.5, 1.5), (0.5, 3.0)
# Hops at their limits are violent: on coarser grids the foot drifts by more than a millimetre.
INTERVALS = {"effort": 50, "time": 160, "height": 80, "distance": 160}
# Price of a hard landing: without one an impact brakes for free, torques do not see it.
IMPULSE_WEIGHT = 0.1


@dataclass(frozen=True)
class _Guess:
    """Crouch, stretch, a parabola, and back to the standing posture, the foot where it belongs."""

    robot: Robot
    distance: float
    durations: tuple[float, float, float]

    def __call__(self, t: float) -> np.ndarray:
        stance, flight, landing = self.durations
        rise, arc = RISE * self.robot.length, gravity_of(self.robot.model) * flight**2 / 2
        s = min(max((t - stance) / flight, 0.0), 1.0)
        if t < stance:
            up = float(common.hermite(t / stance, stance, 0.0, 0.0, rise, 0.0))
        elif t > stance + flight:
            up = float(common.hermite((t - stance - flight) / landing, landing, rise, 0.0, 0.0, 0.0))
        else:
            up = rise + arc * s * (1 - s)
        step = self.distance * s
        lift = (4 * common.CLEARANCE + arc) * s * (1 - s)
        foot = hoppers.standing_foot(self.robot) + np.array([step, 0.0, lift])
        return hoppers.posture(self.robot, step, up, foot)


def _schedule(
    foot: str, target: np.ndarray, durations: tuple[float, float, float], goal: str, *, impact: bool
) -> Schedule:
    """Stance, flight and landing on ``target``; free durations but for effort, anywhere for distance."""
    phases = list(common.hop_schedule({foot: target}, durations, impact=impact).phases)
    if goal != "effort":
        parts = (FREE, FREE_FLIGHT, FREE)
        bounds = [(low * own, high * own) for (low, high), own in zip(parts, durations, strict=True)]
        phases = [replace(phase, duration_bounds=own) for phase, own in zip(phases, bounds, strict=True)]
    if goal == "distance":
        phases[-1] = replace(phases[-1], footholds={})
    return Schedule(tuple(phases))


def _terms(
    goal: str, robot: Robot, schedule: Schedule, end: np.ndarray, ground: FlatGround, direction: float
) -> tuple[Term, ...]:
    """Costs that mean the same in every choice of coordinates: torques, joint angles, contact forces.

    Where a motion is driven to its limits friction is a pyramid: at small forces the squared cone's tolerance
    is that of a square, and lets the foot slip.
    """
    foot = hoppers.foot_of(robot)
    arrival: NodeConstraint = TerminalState(q=end)
    if goal == "distance":
        arrival = TerminalPosture(q=end, over=foot)
    return (
        *goal_terms(
            goal,
            robot,
            schedule,
            frame=robot.contacts[0].frame if goal == "distance" else hoppers.base_frame(robot),
            direction=(direction, 0.0, 0.0),
            effort=effort_costs(joints_only=True),
        ),
        *((ImpulseCost(weight=IMPULSE_WEIGHT),) if schedule.phases[-1].impact else ()),
        EffortLimits(),
        PositionLimits(),
        VelocityLimits(),
        FrictionPyramid(),
        SwingClearance(height=common.CLEARANCE, terrain=ground),
        arrival,
        TerminalRest(q=end),
    )


def build(
    *,
    robot: str,
    distance: float,
    stance: float,
    flight: float,
    landing: float,
    friction: float,
    coordinates: str,
    touchdown: str,
    goal: str,
) -> Problem:
    """Build the hop; see ``FAMILY`` for the parameters. Raises InputError."""
    own = hoppers.hopper(robot)
    durations, foot = (stance, flight, landing), hoppers.foot_of(own)
    place = hoppers.standing_foot(own)
    target, end = place + np.array([distance, 0.0, 0.0]), hoppers.moved(own, distance, 0.0)
    schedule = _schedule(foot, target, durations, goal, impact=touchdown == "impact")
    ground = FlatGround(friction=friction)
    modes = {}
    if coordinates == "minimal":
        if goal == "distance" or own.base != "planar":
            what = f"goal={goal}" if goal == "distance" else f"robot={own.name}"
            raise InputError(
                f"hopper-hop with {what} in minimal coordinates",
                "allowed: coordinates=excess, or a planar hopper that lands on its foothold",
            )
        modes = {
            "stance": stance_mode(own, foot, anchor=place),
            "landing": stance_mode(own, foot, anchor=target),
        }
    return Problem(
        name="hopper-hop",
        robot=own,
        schedule=schedule,
        terrain=ground,
        initial_q=own.reference,
        initial_v=np.zeros(own.nv),
        terms=_terms(goal, own, schedule, end, ground, -1.0 if distance < 0 else 1.0),
        guess=_Guess(own, distance, durations),
        modes=modes,
        default_intervals=INTERVALS[goal],
    )


FAMILY = Family(
    name="hopper-hop",
    robots=hoppers.ROBOTS,
    phases=("stance", "flight", "landing"),
    summary="hop of a hopper and to rest: onto a foothold, as high or as far as possible",
    parameters=(
        common.length("distance", 0.2, "forward displacement; as far as possible: the guess", (-0.6, 0.6)),
        common.duration("stance", 0.4, "duration of the push", (1e-2, 5.0)),
        common.duration("flight", 0.3, "duration of the flight", (1e-2, 5.0)),
        common.duration("landing", 0.5, "duration from touchdown to rest", (1e-2, 5.0)),
        common.friction(0.7),
        Choice(
            name="coordinates",
            default="excess",
            choices=("excess", "minimal"),
            meaning="one floating base with contact rows, or a model for each phase",
        ),
        common.touchdown(),
        common.goal(*INTERVALS),
    ),
    build=build,
)
