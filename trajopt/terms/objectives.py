"""Named goals of a motion, as terms in natural units: the same weights on every robot.

    effort      torques, squared
    time        duration of the free phases
    height      a frame as high as possible, in the middle of a phase
    distance    a frame as far as possible along a direction, at the end
    transport   energy over weight and distance: the cost of transport
    smooth      accelerations, squared
    track       distance from a reference motion

To make the motion unique, a hundredth of the costs of `effort` is added. For time, height and distance it is
a tenth, because these have no curvature of their own: without it torques would jump from limit to limit, and
a robot without torque limits could jump to any height.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

from trajopt.arguments import checked
from trajopt.errors import InputError, not_among
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.moment import Moment, middle_of
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.costs import (
    AccelerationCost,
    DistanceCost,
    FrameHeightCost,
    NodeCost,
    PostureCost,
    TimeCost,
    TorqueCost,
    VelocityCost,
    WrenchCost,
)
from trajopt.terms.drives import PowerCost
from trajopt.terms.interfaces import Cost, Term
from trajopt.terms.tracking import TrackingCost

Goal = Literal["effort", "time", "height", "distance", "transport", "smooth", "track"]
GOALS: tuple[Goal, ...] = get_args(Goal)

# Factors of the effort costs that are added to another goal, and to a linear one. The first makes the motion
# unique and hardly changes it. A linear goal with a tenth of its factor needs up to three times the
# iterations, and its motion a finer grid (docs/modelling/objectives.md).
REST = 1e-2
REST_OF_LINEAR = 1e-1


@checked
def effort_costs(
    *, acceleration: float = 1e-2, velocity: float = 1e-2, posture: float = 1e-1, joints_only: bool = False
) -> tuple[Cost, ...]:
    """Costs of effort: torques, and small weights on everything else, so that the optimum is unique.

    Args:
        acceleration: weight of accelerations; that of torques is one.
        velocity: weight of rates.
        posture: weight of the distance from the reference posture.
        joints_only: whether accelerations and rates of the base are left out.
    """
    return (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=acceleration, joints_only=joints_only),
        VelocityCost(weight=velocity, joints_only=joints_only),
        PostureCost(weight=posture),
        WrenchCost(weight=1e-2),
    )


@checked
def goal_terms(
    goal: str,
    robot: Robot,
    schedule: Schedule,
    *,
    frame: str | None = None,
    at: Moment | None = None,
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0),
    travel: float | None = None,
    reference: Motion | None = None,
    effort: Sequence[Cost] | None = None,
    rest: float | None = None,
) -> tuple[Term, ...]:
    """Cost terms of one of the ``GOALS``, with effort costs that make its motion unique.

    Args:
        goal: name of the goal.
        robot: the robot.
        schedule: its contacts over time.
        frame: name of a frame, for "height" and "distance".
        at: the moment, for "height"; default the middle of the longest phase without contacts.
        direction: in the world (3,), for "distance".
        travel: distance that the motion has to cover, m, for "transport".
        reference: q(t) (nq,), for "track".
        effort: costs of effort, default `effort_costs()`.
        rest: factor of the effort costs when added to another goal, default ``REST`` or ``REST_OF_LINEAR``.

    Raises:
        InputError: for an unknown goal, or one without its argument.
    """
    effort = tuple(effort_costs() if effort is None else effort)
    if goal == "effort":
        return effort
    main: Term
    if goal == "smooth":
        main = AccelerationCost(weight=1.0)
    elif goal == "time":
        if all(index is None for index in schedule.time_scales):
            raise _missing(goal, "a schedule with duration_bounds in some phase")
        main = TimeCost(weight=1.0)
    elif goal in ("height", "distance"):
        if frame is None:
            raise _missing(goal, "a frame's name")
        main = DistanceCost(weight=1.0, frame=frame, direction=direction)
        if goal == "height":
            flights = [phase for phase in schedule.phases if not phase.contacts]
            if at is None and not flights:
                raise _missing("height", "a moment, or a schedule with one without contacts")
            apex = at or middle_of(max(flights, key=lambda phase: phase.duration).name)
            main = FrameHeightCost(weight=1.0, frame=frame, at=apex)
    elif goal == "transport":
        if travel is None or not 0 < travel < math.inf:
            raise _missing(goal, "travel > 0, the way of the motion in m")
        main = PowerCost(weight=Units(robot).length / travel)
    elif goal == "track":
        if reference is None:
            raise _missing(goal, "a reference motion")
        main = TrackingCost(weight=1.0, reference=reference)
    else:
        raise not_among(GOALS, goal, f"goal '{goal}' is unknown")
    linear = isinstance(main, TimeCost | NodeCost)
    share = (REST_OF_LINEAR if linear else REST) if rest is None else rest
    return (main, *(replace(term, weight=share * term.weight) for term in effort))


def _missing(goal: str, what: str) -> InputError:
    return InputError(f"goal '{goal}' lacks what it is about", f"allowed: {what}")
