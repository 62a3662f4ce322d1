"""What a problem models, what it never had rows for, and what could be simpler still: lines of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.asked import Reader
from trajopt.reduced.scenes.report import EXACT, OFFER, Decision
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.friction import ContactConstraint
from trajopt.terms.limits import EffortLimits, PositionLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.transcription.mesh import Mesh

Grid = tuple[str | None, int | None]


def modelled(problem: Problem, whole: Problem, needs: Mapping[str, str]) -> tuple[str, ...]:
    """What is modelled: base, joints with why they are needed, contacts of every phase, inputs."""
    robot = problem.robot
    lines = [f"{robot.base} base, {robot.n_unactuated} rows without actuator, {robot.nu} joints with one"]
    by_reason: dict[str, list[str]] = {}
    own = set(robot.model.names)
    for name, reason in needs.items():
        if name in own and whole.robot.model.joints[whole.robot.model.getJointId(name)].nv == 1:
            by_reason.setdefault(reason, []).append(name)
    lines += [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]
    for phase in problem.schedule.phases:
        sizes = [f"{name} ({robot.contact(name).dimension})" for name in phase.contacts]
        lines.append(f"phase '{phase.name}': " + (f"forces of {', '.join(sizes)}" if sizes else "no forces"))
    lines.append(f"inputs: {problem.actuation}")
    return tuple(lines)


def remarks(problem: Problem, whole: Problem, grid: Grid) -> list[Decision]:
    """Rows and unknowns that were never there, with the reason; and what could go if the caller wants.

    Numbers are for a ``grid`` (transcription, intervals) that defaults to the problem's.
    """
    points = _points(problem, grid)
    never = [*_flight(problem, points), *_limits(problem), *_friction(whole), *_clearance(problem)]
    return [*never, *_offered_points(problem, points), *_offered_velocity(problem)]


def _points(problem: Problem, grid: Grid) -> np.ndarray:
    """Collocation points of every phase."""
    name, total = grid[0] or problem.default_transcription, grid[1] or problem.default_intervals
    mesh = Mesh.uniform(name, problem.schedule.intervals(total))
    return np.array([phase.count * phase.method.s for phase in mesh.phases])


def _flight(problem: Problem, points: np.ndarray) -> list[Decision]:
    """No force of a contact where it is not active: the schedule says so."""
    robot, phases = problem.robot, problem.schedule.phases
    count = 0
    for number, phase in zip(points, phases, strict=True):
        count += int(number) * sum(c.dimension for c in robot.contacts if c.name not in phase.contacts)
    if not count:
        return []
    return [
        Decision(
            kind=EXACT,
            what=f"forces of contacts in the air, {count} unknowns and their complementarity rows",
            why="the schedule says who is in contact: a contact that is not has neither force nor row",
        )
    ]


def _limits(problem: Problem) -> list[Decision]:
    """Limits that no motion of the robot's size reaches, and limits that do not exist."""
    found = []
    for term in problem.terms:
        if isinstance(term, EffortLimits | VelocityLimits | PositionLimits):
            beyond, why = _beyond(term, problem.robot)
            if beyond:
                what = f"rows of {beyond} {term.name.replace('_', ' ')}"
                found.append(Decision(kind=EXACT, what=what, why=why))
    return found


def _beyond(term: EffortLimits | VelocityLimits | PositionLimits, robot: Robot) -> tuple[int, str]:
    """How many finite limits a term leaves out, and by which measure."""
    units, first = Units(robot), robot.n_unactuated
    if isinstance(term, EffortLimits):
        limit = robot.effort_limit if term.limit is None else np.asarray(term.limit)
        far = np.zeros(0) if limit is None else limit[np.isfinite(limit)] >= units.unreachable_torque
        return int(
            np.sum(far)
        ), f"beyond 30 m g l = {units.unreachable_torque:.3g} N m; the check verifies them"
    if isinstance(term, VelocityLimits):
        speed = robot.velocity_limit[first:]
        far = speed[np.isfinite(speed)] >= units.unreachable_velocity
        why = f"beyond 30 sqrt(g / l) = {units.unreachable_velocity:.3g} rad/s; the check verifies them"
        return int(np.sum(far)), why
    lower, upper = robot.position_lower, robot.position_upper
    far = (lower <= robot.reference - 2 * math.pi) & (upper >= robot.reference + 2 * math.pi)
    far &= np.isfinite(lower) & np.isfinite(upper)
    return int(np.sum(far)), "more than a turn from the reference posture; the check verifies them"


def _friction(problem: Problem) -> list[Decision]:
    """Friction of bilateral contacts."""
    held = [
        f"'{name}' in '{phase.name}'"
        for phase in problem.schedule.phases
        for name in phase.contacts
        if phase.surface(name, problem.terrain).bilateral
    ]
    if not held or not any(isinstance(term, ContactConstraint) for term in problem.terms):
        return []
    why = "the surface holds the contact in every direction"
    return [Decision(kind=EXACT, what=f"friction rows of {', '.join(held)}", why=why)]


def _clearance(problem: Problem) -> list[Decision]:
    """Clearance of contacts that never leave the ground."""
    if not any(isinstance(term, SwingClearance) for term in problem.terms):
        return []
    phases = problem.schedule.phases
    always = [c.name for c in problem.robot.contacts if all(c.name in phase.contacts for phase in phases)]
    if not always:
        return []
    why = "always on the ground"
    return [Decision(kind=EXACT, what=f"clearance rows of {', '.join(always)}", why=why)]


def _offered_points(problem: Problem, points: np.ndarray) -> list[Decision]:
    held = {n for phase in problem.schedule.phases for n, s in phase.surfaces.items() if s.bilateral}
    soles = [c for c in problem.robot.contacts if c.kind == "surface" and c.name not in held]
    active = [
        int(number)
        * sum(c.dimension - len([r for r in c.rows if r < 3]) for c in soles if c.name in phase.contacts)
        for number, phase in zip(points, problem.schedule.phases, strict=True)
    ]
    if not sum(active) or len(soles) < 2:
        return []
    return [
        Decision(
            kind=OFFER,
            what=f"soles {', '.join(c.name for c in soles)} as points: {sum(active)} unknowns less",
            why="only where a sole's moment does not matter, two or more being apart: it may tilt",
        )
    ]


def _offered_velocity(problem: Problem) -> list[Decision]:
    """A velocity source, where nothing asks for accelerations or for rates at nodes."""
    if problem.actuation != "acceleration" or problem.robot.n_unactuated or problem.initial_v.any():
        return []
    if any(phase.contacts for phase in problem.schedule.phases):
        return []
    for asked in Reader(problem).every(dynamics=False):
        context = asked.context
        rates = asked.node is not None and asked.uses(context.rates)
        if rates or (asked.node is None and asked.uses(context.ddxi)):
            return []
    why = "replace(problem, actuation='velocity'): configurations are the state, and rates may jump"
    return [Decision(kind=OFFER, what="accelerations, with velocities as inputs", why=why)]
