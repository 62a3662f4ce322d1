"""Joints that leave the plane, locked where a limb of a half moves in it without them: abduction, mostly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.asked import Reader
from trajopt.reduced.scenes.lock import locked, out_of_plane
from trajopt.reduced.scenes.reduction import Reduction
from trajopt.reduced.scenes.task import TASK
from trajopt.reduced.scenes.terminal import HalfEnd
from trajopt.terms.frames import FrameHeight
from trajopt.terms.landing import ContactLanding
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalState

# Terms about frames that ask for nothing across the plane; landings on footholds are looked at apart.
ALONG_PLANE = (ContactLanding, FrameHeight, SwingClearance)


@dataclass(frozen=True)
class Flat:
    """The reduction to limbs in the plane, or None; what it locks and why; what it could not lock."""

    reduction: Reduction | None
    what: str = ""
    why: str = ""
    refused: str = ""


def flattened(problem: Problem, keep: Sequence[str]) -> Flat:
    """Lock the joints of a half's limbs that leave the plane, where the task asks for nothing across it."""
    robot, q = problem.robot, problem.initial_q
    wanted = {*keep, *_across(problem)}
    to_lock, stay = out_of_plane(robot, q, tuple(wanted))
    refused = f"{', '.join(stay)}: their limbs' other joints leave it too, or a goal or the caller wants them"
    if not to_lock:
        return Flat(None, refused=refused if stay else "")
    names = [contact.name for contact in robot.contacts]
    return Flat(
        locked(robot, to_lock, names, q),
        f"{len(to_lock)} joints that leave the plane locked: {', '.join(to_lock)}",
        "at their start, in pairs: the limbs' other joints move in planes without them, feet do not slide",
        refused if stay else "",
    )


def _across(problem: Problem) -> set[str]:
    """Joints of limbs of which the task asks for something across the plane."""
    robot, model = problem.robot, problem.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, problem.initial_q)
    frames = set()
    for phase in problem.schedule.phases:
        for name in phase.contacts:
            frame = robot.contact(name).frame
            place = data.oMf[model.getFrameId(frame)].translation
            moved = abs(phase.footholds.get(name, place)[1] - place[1]) > TASK * robot.length
            plane = phase.surface(name, problem.terrain).plane_at(place)
            if moved or abs(plane.normal[1]) > TASK:
                frames.add(frame)
    for asked in Reader(problem).every(dynamics=False):
        if asked.node is not None and not isinstance(asked.term, ALONG_PLANE):
            frames |= set(asked.frames)
    carriers = {int(model.frames[model.getFrameId(frame)].parentJoint) for frame in frames}
    return {model.names[j] for carrier in carriers for j in model.supports[carrier]} | _goals(problem)


def _goals(problem: Problem) -> set[str]:
    """Joints that a goal wants elsewhere than at their start."""
    found: set[str] = set()
    for term in problem.terms:
        if isinstance(term, HalfEnd) and isinstance(term.term, TerminalState):
            goal = term.reduction.drop_q(np.asarray(term.term.q, dtype=float))
            apart = np.abs(goal - problem.initial_q) > TASK
            found |= {
                problem.robot.model.names[j.id]
                for j in list(problem.robot.model.joints)[2:]
                if apart[j.idx_q : j.idx_q + j.nq].any()
            }
    return found
