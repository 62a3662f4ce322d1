"""Whether a problem can be solved in the plane: robot and task their own mirror images; and its half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.half import half_robot, turned_by_mirror
from trajopt.reduced.scenes.lock import chained, locked
from trajopt.reduced.scenes.reduction import Reduction
from trajopt.reduced.scenes.report import CHOICE, EXACT
from trajopt.reduced.scenes.task import TASK, Found, require_symmetric
from trajopt.reduced.scenes.terms import reduced_problem
from trajopt.robot.mirror import Mirror, find_mirror, limit_differences, paired_contacts, pairs

# A robot may differ from its mirror image by this, parts of its mass and length: what descriptions made
# by hand from CAD leave (Solo12 8e-6, Talos 2e-3, A1 1.1e-2), less than masses are usually known to.
ASYMMETRY = 2e-2
# Below this robot and task are symmetric up to rounding of descriptions and of kinematics.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Halved:
    """The reduction to the half, and the decision that it is."""

    reduction: Reduction
    kind: str
    what: str
    why: str


def halved(problem: Problem, keep: Sequence[str]) -> Halved:
    """Return the half of a problem's robot. Raises `InputError` that says what is not symmetric.

    ``keep`` are joints that must not be locked.
    """
    mirror = _mirror(problem)
    turned = turned_by_mirror(problem.robot, mirror)
    wanted = [name for name in turned if name in keep]
    if wanted:
        raise InputError(f"joints {', '.join(wanted)} leave the plane, and are kept", "do not keep them")
    names = [contact.name for contact in problem.robot.contacts]
    straight = locked(problem.robot, turned, names, problem.initial_q)
    small = reduced_problem(problem, straight) if turned else problem
    mirror = _mirror(small) if turned else mirror
    images = paired_contacts(small.robot, mirror, TASK)
    found = require_symmetric(small, mirror, images)
    half = half_robot(small.robot, mirror, images, small.initial_q)
    reduction = chained(straight, half) if turned else half
    limits = limit_differences(small.robot, mirror)
    exact = max(mirror.asymmetry, found.difference) < ROUNDING and not limits
    what = f"the right side, which follows the left: {len(pairs(small.robot, mirror))} joints"
    if turned:
        what += f", and {', '.join(turned)} stay in the plane"
    return Halved(reduction, EXACT if exact else CHOICE, what, _why(mirror, found, limits))


def _mirror(problem: Problem) -> Mirror:
    mirror = find_mirror(problem.robot)
    if not mirror.asymmetry <= ASYMMETRY:
        raise InputError(
            f"robot '{problem.robot.name}' differs from its mirror image by {mirror.asymmetry:.2g}"
            f" ({mirror.worst})",
            f"at most {ASYMMETRY:g}, parts of mass and length",
        )
    return mirror


def _why(mirror: Mirror, found: Found, limits: list[str]) -> str:
    asymmetry = f"robot within {mirror.asymmetry:.1e} of its mirror image"
    if mirror.asymmetry >= ROUNDING:
        asymmetry += f" ({mirror.worst})"
    task = f"task within {found.difference:.1e}"
    text = f"{asymmetry}, {task}; its optimum is one of the whole problem, among mirrored motions the best"
    return text + (f"; tighter limits of {', '.join(limits)}" if limits else "")
