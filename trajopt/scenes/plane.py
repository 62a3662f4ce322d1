"""Symmetric tasks in the plane: the half of the robot, and its joints that leave the plane.

A half is found where robot and task are their own mirror images. Where a limb of it moves in the plane
without the joints that leave it (abduction, mostly), these are locked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from trajopt.dynamics.rerooting import joints_with
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.term_reader import TermReader
from trajopt.robot.building import leaving_plane
from trajopt.robot.mirror import Mirror, find_mirror, limit_differences, paired_contacts, pairs
from trajopt.scenes.half import half_robot, turned_by_mirror
from trajopt.scenes.reduction import Reduction, lock_joints
from trajopt.scenes.report import CHOICE, EXACT, Decision
from trajopt.scenes.task import TASK, Asymmetry, require_symmetric
from trajopt.scenes.terms import reduced_problem
from trajopt.scenes.whole_terms import HalfEnd
from trajopt.terms.frames import FrameHeight
from trajopt.terms.landing import ContactLanding
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalState

# Largest difference of a robot from its mirror image, over its mass and length: errors of descriptions made
# by hand from CAD (Solo12 8e-6, Talos 2e-3, A1 1.1e-2), less than masses are usually known to.
ASYMMETRY = 2e-2
# Below this, robot and task are symmetric up to rounding in descriptions and kinematics.
ROUNDING = 1e-9
# Terms about frames that constrain nothing across the plane; footholds are checked separately.
ALONG_PLANE = (ContactLanding, FrameHeight, SwingClearance)


def halve_robot(problem: Problem, keep: Sequence[str]) -> tuple[Reduction, Decision]:
    """Return the reduction to the half of a problem's robot, and the decision for the report.

    ``keep`` are joints that must not be locked. Raises `InputError` that names what is not symmetric.
    """
    mirror = _mirror(problem)
    turned = turned_by_mirror(problem.robot, mirror)
    wanted = [name for name in turned if name in keep]
    if wanted:
        raise InputError(f"joints {', '.join(wanted)} leave the plane, and are kept", "do not keep them")
    straight = lock_joints(problem.robot, turned, problem.initial_q)
    small = reduced_problem(problem, straight) if turned else problem
    mirror = _mirror(small) if turned else mirror
    images = paired_contacts(small.robot, mirror, TASK)
    asymmetry = require_symmetric(small, mirror, images)
    half = half_robot(small.robot, mirror, images, small.initial_q)
    reduction = straight.then(half) if turned else half
    limits = limit_differences(small.robot, mirror)
    exact = max(mirror.asymmetry, asymmetry.difference) < ROUNDING and not limits
    what = f"the right side, which follows the left: {len(pairs(small.robot, mirror))} joints"
    if turned:
        what += f", and {', '.join(turned)} stay in the plane"
    kind = EXACT if exact else CHOICE
    return reduction, Decision(kind=kind, what=what, why=_why(mirror, asymmetry, limits))


def _mirror(problem: Problem) -> Mirror:
    mirror = find_mirror(problem.robot)
    if not mirror.asymmetry <= ASYMMETRY:
        raise InputError(
            f"robot '{problem.robot.name}' differs from its mirror image by {mirror.asymmetry:.2g}"
            f" ({mirror.worst})",
            f"at most {ASYMMETRY:g}, parts of mass and length",
        )
    return mirror


def _why(mirror: Mirror, task_asymmetry: Asymmetry, limits: list[str]) -> str:
    asymmetry = f"robot within {mirror.asymmetry:.1e} of its mirror image"
    if mirror.asymmetry >= ROUNDING:
        asymmetry += f" ({mirror.worst})"
    task = f"task within {task_asymmetry.difference:.1e}"
    text = f"{asymmetry}, {task}; its optimum is one of the whole problem, among mirrored motions the best"
    return text + (f"; tighter limits of {', '.join(limits)}" if limits else "")


def in_plane(problem: Problem, keep: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints of a half's limbs that leave the plane: those to lock, and those that cannot be.

    With these joints locked at the start, the others of the limb must move in the plane: an abducted leg
    moves in a different plane. Limbs with a joint in ``keep``, or for which the task requires motion across
    the plane, stay as they are.
    """
    model, wanted = problem.robot.model, {*keep, *_across(problem)}
    leaving = leaving_plane(model, 1, problem.initial_q)
    to_lock: list[str] = []
    stay: list[str] = []
    for root in (j for j in range(2, model.njoints) if model.parents[j] == 1):
        limb = [j for j in range(2, model.njoints) if root in model.supports[j]]
        leaves = [model.names[j] for j in limb if j in leaving]
        movable = len(leaves) < len(limb) and not any(name in wanted for name in leaves)
        (to_lock if movable else stay).extend(leaves)
    return tuple(to_lock), tuple(stay)


def _across(problem: Problem) -> set[str]:
    """Joints of limbs for which the task requires motion across the plane."""
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
    for instance in TermReader(problem).every():
        if instance.node is not None and not isinstance(instance.term, ALONG_PLANE):
            frames |= set(instance.frames)
    carriers = {int(model.frames[model.getFrameId(frame)].parentJoint) for frame in frames}
    return {model.names[j] for carrier in carriers for j in model.supports[carrier]} | _goals(problem)


def _goals(problem: Problem) -> set[str]:
    """Joints whose goal differs from their start."""
    joints: set[str] = set()
    for term in problem.terms:
        if isinstance(term, HalfEnd) and isinstance(term.term, TerminalState):
            goal = term.reduction.drop_q(np.asarray(term.term.q, dtype=float))
            apart = np.abs(goal - problem.initial_q) > TASK
            joints.update(joints_with(problem.robot.model, apart))
    return joints
