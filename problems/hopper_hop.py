"""A hop on one leg: onto a foothold, as high or as far as possible, of a hopper in the plane or in space.

In minimal coordinates of each phase or as one floating-base system.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from trajopt.dynamics import gravity_of
from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Robot, StanceMode, stance_mode
from trajopt.schedule import Schedule
from trajopt.terms import ImpulseCost, TerminalPosture, TerminalRest, TerminalState, effort_costs, goal_terms

from . import common, hoppers

# Rise of the base while the leg extends in the guess, over the robot's length.
RISE = 0.17
# Bounds of free durations, for every goal but effort, as multiples of the nominal ones: time on the ground is
# for one push, but a flight may be long.
FREE, FREE_FLIGHT = (0.5, 1.5), (0.5, 3.0)
# Hops at the limits are violent: on coarser grids the foot drifts by more than a millimetre.
INTERVALS = {"effort": 50, "time": 160, "height": 80, "distance": 160}
# Costs that do not depend on the choice of coordinates: torques, joint angles, contact forces.
COSTS = effort_costs(joints_only=True)


def _guess(robot: Robot, distance: float, durations: tuple[float, float, float], t: float) -> np.ndarray:
    """Crouch, stretch, fly on a parabola, and return to standing, with the foot on its foothold."""
    stance, flight, landing = durations
    rise, arc = RISE * robot.length, gravity_of(robot.model) * flight**2 / 2
    start = hoppers.standing_foot(robot)
    s = min(max((t - stance) / flight, 0.0), 1.0)
    if t < stance:
        up = float(common.hermite(t / stance, stance, 0.0, 0.0, rise, 0.0))
    elif t > stance + flight:
        up = float(common.hermite((t - stance - flight) / landing, landing, rise, 0.0, 0.0, 0.0))
    else:
        up = rise + arc * s * (1 - s)
    lift = (4 * common.CLEARANCE + arc) * s * (1 - s)
    return hoppers.posture(robot, distance * s, up, start + np.array([distance * s, 0.0, lift]))


def _schedule(
    foot: str, target: np.ndarray, durations: tuple[float, float, float], goal: str, *, impact: bool
) -> Schedule:
    """Return stance, flight and landing on ``target`` (anywhere for distance), with free durations."""
    schedule = common.hop_schedule({foot: target}, durations, impact=impact)
    if goal != "effort":
        schedule = common.freed(schedule, FREE, FREE_FLIGHT, FREE)
    if goal == "distance":
        *before, landing = schedule.phases
        return Schedule((*before, replace(landing, footholds={})))
    return schedule


def _modes(robot: Robot, place: np.ndarray, target: np.ndarray, goal: str) -> dict[str, StanceMode]:
    """Return the models of the stance phases on ``place`` and ``target`` (3,) m. Raises InputError."""
    if goal == "distance" or robot.base != "planar":
        what = f"goal={goal}" if goal == "distance" else f"robot={robot.name}"
        raise InputError(
            f"hopper-hop with {what} in minimal coordinates",
            "allowed: coordinates=excess, or a planar hopper that lands on its foothold",
        )
    foot = hoppers.foot_of(robot)
    return {
        "stance": stance_mode(robot, foot, anchor=place),
        "landing": stance_mode(robot, foot, anchor=target),
    }


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
    body = hoppers.hopper(robot)
    durations, foot = (stance, flight, landing), hoppers.foot_of(body)
    place = hoppers.standing_foot(body)
    target, end = place + np.array([distance, 0.0, 0.0]), hoppers.moved(body, distance, 0.0)
    impact, far = touchdown == "impact", goal == "distance"
    schedule = _schedule(foot, target, durations, goal, impact=impact)
    aim = goal_terms(
        goal,
        body,
        schedule,
        frame=body.contacts[0].frame if far else hoppers.base_frame(body),
        direction=(-1.0 if distance < 0 else 1.0, 0.0, 0.0),
        effort=COSTS,
    )
    return common.problem(
        "hopper-hop",
        body,
        schedule,
        partial(_guess, body, distance, durations),
        costs=(*aim, *((ImpulseCost(weight=common.IMPULSE_WEIGHT),) if impact else ())),
        friction=friction,
        clearance=common.CLEARANCE,
        end=(TerminalPosture(q=end, over=foot) if far else TerminalState(q=end), TerminalRest(q=end)),
        modes=_modes(body, place, target, goal) if coordinates == "minimal" else {},
        default_intervals=INTERVALS[goal],
    )


FAMILY = Family(
    name="hopper-hop",
    robots=hoppers.ROBOTS,
    phases=("stance", "flight", "landing"),
    summary="hop once and come to rest: onto a foothold, as high or as far as possible",
    parameters=(
        common.length("distance", 0.2, "forward displacement; with goal=distance its guess", (-0.6, 0.6)),
        common.duration("stance", 0.4, "duration of the push", (1e-2, 5.0)),
        common.duration("flight", 0.3, "duration of the flight", (1e-2, 5.0)),
        common.duration("landing", 0.5, "duration from touchdown to rest", (1e-2, 5.0)),
        common.friction(0.7),
        common.choice(
            "coordinates",
            "floating base with contact constraints, or a fixed-base model for each stance",
            "excess",
            "minimal",
        ),
        common.TOUCHDOWN,
        common.goal(*INTERVALS),
    ),
    build=build,
)
