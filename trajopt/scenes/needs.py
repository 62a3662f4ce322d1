"""The joints that a task needs, each with its reason; all others may be locked."""

from collections.abc import Sequence

import numpy as np

from trajopt.dynamics.base_joint import BASE_COORDINATES
from trajopt.dynamics.rerooting import joints_with
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.term_reader import TermInstance, TermReader
from trajopt.robot.robot import Robot
from trajopt.terms.context_symbols import Place
from trajopt.terms.costs import (
    AccelerationCost,
    ImpulseCost,
    PostureCost,
    TimeCost,
    TorqueCost,
    VelocityCost,
    WrenchCost,
)
from trajopt.terms.drives import DriveLimits, MotorTorqueCost
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalRest, TerminalState

# Costs and limits that a joint at rest at its start satisfies.
NO_NEED = (
    TorqueCost, AccelerationCost, VelocityCost, WrenchCost, TimeCost, ImpulseCost, MotorTorqueCost,
    TorqueLimits, VelocityLimits, PositionLimits, DriveLimits, TerminalRest,
)  # fmt: skip
# A joint whose goal is within this distance of its start, rad or m, may stay: postures in files are rounded.
SAME_PLACE = 1e-9

Needs = dict[str, str]
KEPT_AS_ASKED = "kept as asked"


def needed_joints(problem: Problem, keep: Sequence[str]) -> Needs:
    """Return the joints that must move, by name, each with the first reason found.

    These are: joints of the base, passive joints, joints that start with a velocity, joints that carry an
    active contact or a frame used by a term, joints whose goal differs from their start, joints in ``keep``,
    and joints whose coordinates are used by a term of unknown kind; mimic joints and their leaders come
    together. Raises `InputError` for an unknown name in ``keep``.
    """
    robot, needs = problem.robot, _always(problem)
    _require_known(robot, keep, "keep")
    for phase in problem.schedule.phases:
        for contact in phase.contacts:
            _chain(robot, robot.contact(contact).frame, f"carries contact '{contact}'", needs)
    for instance in TermReader(problem).every():
        for frame in instance.frames:
            _chain(robot, frame, f"moves frame '{frame}' of {instance.term.name}", needs)
        for name in _direct_joints(problem, instance):
            needs.setdefault(name, f"is in {instance.term.name}")
    for term in problem.terms:
        if isinstance(term, PostureCost | TerminalState):  # does the target differ from the start?
            target = robot.reference if term.q is None else np.asarray(term.q, dtype=float)
            apart = np.abs(target - problem.initial_q)
            apart[: BASE_COORDINATES[robot.base]] = 0.0
            for name in joints_with(robot.model, apart > SAME_PLACE):
                needs.setdefault(name, f"{term.name} wants it elsewhere")
    for name in keep:
        needs.setdefault(name, KEPT_AS_ASKED)
    for mimic in robot.mimics:
        if mimic.joint in needs or mimic.mimics in needs:
            needs.setdefault(mimic.joint, f"follows '{mimic.mimics}'")
            needs.setdefault(mimic.mimics, f"leads '{mimic.joint}'")
    return needs


def cleared_contacts(problem: Problem) -> set[str]:
    """Return the contacts that a clearance term keeps off the ground in some phase."""
    frames = {
        frame
        for instance in TermReader(problem).every()
        if isinstance(instance.term, SwingClearance)
        for frame in instance.frames
    }
    return {contact.name for contact in problem.robot.contacts if contact.frame in frames}


def require_lockable(problem: Problem, lock: Sequence[str], keep: Sequence[str]) -> None:
    """Raise `InputError` for joints to lock that are unknown, kept, passive, moving, or part of the base."""
    _require_known(problem.robot, lock, "lock")
    for name in lock:
        reason = "is kept as well" if name in keep else _always(problem).get(name)
        if reason:
            raise InputError(f"joint '{name}' to lock {reason}", "another joint")


def _require_known(robot: Robot, names: Sequence[str], purpose: str) -> None:
    known = list(robot.model.names)[1:]
    for name in names:
        if name not in known:
            raise InputError(f"joint '{name}' to {purpose} is unknown", "one of " + ", ".join(known))


def _always(problem: Problem) -> Needs:
    robot, needs = problem.robot, {}
    followers = {mimic.joint for mimic in robot.mimics}
    for joint in list(robot.model.joints)[1:]:
        name = robot.model.names[joint.id]
        if joint.idx_v in robot.unactuated_rows and name not in followers:
            needs[name] = "has no actuator" if name in robot.passive else "is the base"
        elif problem.initial_v[joint.idx_v : joint.idx_v + joint.nv].any():
            needs[name] = "starts moving"
    return needs


def _chain(robot: Robot, frame: str, reason: str, needs: Needs) -> None:
    model = robot.model
    for joint in model.supports[model.frames[model.getFrameId(frame)].parentJoint]:
        if joint > 0:
            needs.setdefault(model.names[joint], reason)


def _direct_joints(problem: Problem, instance: TermInstance) -> list[str]:
    """Return the joints whose coordinates are used directly by a term of unknown kind."""
    if (
        isinstance(instance.term, (*NO_NEED, PostureCost, TerminalState))
        or instance.context.place is Place.IMPACT
    ):
        return []
    return joints_with(problem.robot.model, instance.rates())
