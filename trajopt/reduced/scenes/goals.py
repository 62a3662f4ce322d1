"""The smallest problem for a robot, a schedule and goals; default costs, limits and guess fit most scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.errors import InputError, finite_array
from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.smallest_scene import Plane, SmallestScene, smallest
from trajopt.robot.contact import require_frame
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import footholds_at
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.costs import AccelerationCost, PostureCost, TorqueCost, VelocityCost, WrenchCost
from trajopt.terms.drives import DriveLimits
from trajopt.terms.frames import FramePose
from trajopt.terms.friction import FrictionCone, SoleCone
from trajopt.terms.interfaces import Term
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalRest, TerminalState
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import SAME_PLANE

Goals = Mapping[str, pin.SE3 | ArrayLike] | ArrayLike

# Swing height of a foot over the robot's length: a few centimetres for a leg of half a metre.
CLEARANCE = 0.1


@checked
def scene(
    robot: Robot,
    schedule: Schedule,
    goals: Goals | None = None,
    *,
    terrain: FlatGround | None = None,
    start: ArrayLike | None = None,
    start_rates: ArrayLike | None = None,
    rest: bool = True,
    costs: Sequence[Term] | None = None,
    terms: Sequence[Term] = (),
    guess: Motion | None = None,
    name: str = "scene",
    keep: Sequence[str] = (),
    plane: Plane = "auto",
) -> SmallestScene:
    """Return the smallest problem that takes ``robot`` through ``schedule`` to its ``goals``.

    The problem always has the robot's effort limits (those of its drives, if it has any), velocity and
    position limits, friction at every contact (the cone of the whole sole for surface contacts), landings
    from the schedule, and a swing clearance of a tenth of the robot's length.

    Args:
        robot: The whole robot.
        schedule: Phases with their contacts.
        goals: What must hold at the end: a pose (`pin.SE3`) or position (3,) in m for each named frame; or a
            configuration (nq,), in which case contacts that land do so where the configuration has them.
            Default: no goals.
        terrain: Default: level ground at height 0 with friction 0.7.
        start: Configuration (nq,); default: the reference.
        start_rates: Rates (nv,); default: at rest.
        rest: Whether the motion ends at rest.
        costs: Default: weight 1 on torques, 1e-2 on contact forces, accelerations and rates, 1e-1 on the
            distance from the start, each over its natural unit.
        terms: Additional constraints or costs.
        guess: Motion t -> (nq,); default: the one of `Problem`.
        name: Name of the problem.
        keep: Joints that are never locked.
        plane: See `smallest`.

    Raises:
        InputError: If goals, start or contacts do not fit the robot.
    """
    ground = FlatGround() if terrain is None else terrain
    first = np.array(robot.reference if start is None else start, dtype=float)
    rates = np.zeros(robot.nv) if start_rates is None else np.array(start_rates, dtype=float)
    if first.shape != (robot.nq,):
        raise InputError(f"start of scene '{name}' has shape {first.shape}", f"({robot.nq},)")
    for phase in schedule.phases:
        for contact in phase.contacts:
            robot.contact(contact)
    goal_terms, posture = _goals(robot, goals)
    if posture is not None:
        schedule = _landing_on(robot, schedule, ground, posture)
    if costs is None:
        forces = [WrenchCost(weight=1e-2)] if any(phase.contacts for phase in schedule.phases) else []
        smooth = [AccelerationCost(weight=1e-2), VelocityCost(weight=1e-2), PostureCost(weight=1e-1, q=first)]
        costs = (TorqueCost(weight=1.0), *forces, *smooth)
    problem = Problem(
        name=name,
        robot=robot,
        schedule=schedule,
        terrain=ground,
        initial_q=first,
        initial_v=rates,
        terms=(
            *costs,
            *_limits(robot, schedule, ground),
            *goal_terms,
            *([TerminalRest()] if rest else []),
            *terms,
        ),
    )
    if guess is not None:
        problem = replace(problem, guess=guess)
    return smallest(problem, keep=keep, plane=plane)


def _goals(robot: Robot, goals: Goals | None) -> tuple[list[Term], np.ndarray | None]:
    """Return the terms of the goals, and the goal configuration (nq,) if the goals are one."""
    if goals is None:
        return [], None
    if not isinstance(goals, Mapping):
        q = np.array(goals, dtype=float)
        if q.shape != (robot.nq,) or not np.isfinite(q).all():
            allowed = f"({robot.nq},), finite; or frames by name"
            raise InputError(f"goal configuration has shape {q.shape}", allowed)
        return [TerminalState(q=q)], q
    terms: list[Term] = []
    for frame, goal in goals.items():
        require_frame(robot.model, frame, "a goal")
        if isinstance(goal, pin.SE3):
            terms.append(FramePose(frame=frame, position=goal.translation, rotation=goal.rotation))
        else:
            position = finite_array(f"goal of frame '{frame}'", goal, unit="m, or a pin.SE3")
            terms.append(FramePose(frame=frame, position=position))
    return terms, None


def _landing_on(robot: Robot, schedule: Schedule, ground: FlatGround, posture: np.ndarray) -> Schedule:
    """Add the missing footholds at the last landing of each contact that is active at the end.

    The goal constrains only what the contacts leave free, so they must land where it has them.
    """
    places, phases = footholds_at(robot, posture, ground), list(schedule.phases)
    for name in phases[-1].contacts:
        began = [i for i in range(len(phases)) if name in schedule.new_contacts(i)]
        if not began or name in phases[began[-1]].footholds:
            continue
        phase, place = phases[began[-1]], places[name]
        if abs(float(phase.surface(name, ground).distance(place))) <= SAME_PLANE:
            phases[began[-1]] = replace(phase, footholds={**phase.footholds, name: place})
    return Schedule(tuple(phases))


def _limits(robot: Robot, schedule: Schedule, ground: FlatGround) -> tuple[Term, ...]:
    torque: Term = DriveLimits() if any(drive is not None for drive in robot.drives or ()) else TorqueLimits()
    limits: list[Term] = [torque, PositionLimits(), VelocityLimits()]
    active = [c for c in robot.contacts if any(c.name in phase.contacts for phase in schedule.phases)]
    points = tuple(contact.name for contact in active if contact.kind == "point")
    if points:
        limits.append(FrictionCone(contacts=points))
    if len(points) < len(active):
        limits.append(SoleCone())
    if any(not set(phase.contacts) >= {c.name for c in active} for phase in schedule.phases):
        limits.append(SwingClearance(height=CLEARANCE * robot.length, terrain=ground))
    return tuple(limits)
