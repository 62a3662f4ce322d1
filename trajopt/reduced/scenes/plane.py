"""Symmetric tasks in the plane: the half of the robot, and its joints that leave the plane.

The robot is halved if robot and task are their own mirror images. If the other joints of a limb move in the
plane without those that leave it (usually abduction), the latter are locked. Start, contacts and surfaces are
compared with their mirror images directly, terms at random states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.rerooting import joints_with
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.half import half_robot, turned_by_mirror
from trajopt.reduced.scenes.reduction import Reduction, lock_joints
from trajopt.reduced.scenes.report import CHOICE, EXACT, Decision
from trajopt.reduced.scenes.terms import reduced_problem
from trajopt.reduced.scenes.whole_terms import HalfEnd
from trajopt.reduced.term_reader import TermInstance, TermReader
from trajopt.robot.building import leaving_plane
from trajopt.robot.mirror import (
    REFLECTION,
    TWIST,
    Mirror,
    find_mirror,
    limit_differences,
    mirrored_configuration,
    mirrored_rows,
    paired_contacts,
    pairs,
)
from trajopt.schedule.schedule import Phase
from trajopt.terms.context_symbols import Place
from trajopt.terms.frames import FrameHeight
from trajopt.terms.landing import ContactLanding
from trajopt.terms.swing import SwingClearance
from trajopt.terms.terminal import TerminalState
from trajopt.terrain.flat import FlatGround

# Largest difference between a robot and its mirror image, over its mass and length. Hand-written models from
# CAD have errors (Solo12 8e-6, Talos 2e-3, A1 1.1e-2) below the accuracy to which masses are usually known.
ASYMMETRY = 2e-2
# Below this difference, robot and task are symmetric up to rounding in models and kinematics.
ROUNDING = 1e-9
# Frame terms that constrain nothing across the plane; footholds are checked separately.
ALONG_PLANE = (ContactLanding, FrameHeight, SwingClearance)
# Largest difference of start, goals and terms from their mirror images, in scaled units (rad, lengths of the
# robot): below the accuracy of joint calibration. Tasks with a larger difference are asymmetric.
TASK = 1e-3
# Terms with dynamics may differ from their mirror images by this multiple of the robot's asymmetry: an error
# in one inertia enters several rows.
ASYMMETRY_GAIN = 20.0
# Number of random states, of order one in scaled units, at which rows and costs are compared.
STATES = 2
# Largest deviation of the base's heading from the world's x axis, rad.
HEADING = 1e-6


def halve_robot(problem: Problem, keep: Sequence[str]) -> tuple[Reduction, Decision]:
    """Return the reduction to the half of a problem's robot, and the decision for the report.

    Joints in ``keep`` must not be locked. Raises `InputError` that names what is not symmetric.
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
    return reduction, Decision(kind=kind, what=what, why=_reason(mirror, asymmetry, limits))


def _mirror(problem: Problem) -> Mirror:
    mirror = find_mirror(problem.robot)
    if not mirror.asymmetry <= ASYMMETRY:
        raise InputError(
            f"robot '{problem.robot.name}' differs from its mirror image by {mirror.asymmetry:.2g}"
            f" ({mirror.worst})",
            f"at most {ASYMMETRY:g}, parts of mass and length",
        )
    return mirror


def _reason(mirror: Mirror, task_asymmetry: Asymmetry, limits: list[str]) -> str:
    asymmetry = f"robot within {mirror.asymmetry:.1e} of its mirror image"
    if mirror.asymmetry >= ROUNDING:
        asymmetry += f" ({mirror.worst})"
    task = f"task within {task_asymmetry.difference:.1e}"
    text = f"{asymmetry}, {task}; its optimum is one of the whole problem, among mirrored motions the best"
    return text + (f"; tighter limits of {', '.join(limits)}" if limits else "")


def in_plane(problem: Problem, keep: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints of a half's limbs that leave the plane: those to lock, and those to leave free.

    They are locked if the limb has other joints, which then move in a plane parallel to the base's: an
    abducted leg moves in a different plane. Limbs whose leaving joints are in ``keep``, or that the task
    moves across the plane, stay as they are.
    """
    model, wanted = problem.robot.model, {*keep, *_joints_across(problem)}
    leaving = leaving_plane(model, 1, problem.initial_q)
    to_lock: list[str] = []
    stay: list[str] = []
    for root in (j for j in range(2, model.njoints) if model.parents[j] == 1):
        limb = [j for j in range(2, model.njoints) if root in model.supports[j]]
        leaves = [model.names[j] for j in limb if j in leaving]
        movable = len(leaves) < len(limb) and not any(name in wanted for name in leaves)
        (to_lock if movable else stay).extend(leaves)
    return tuple(to_lock), tuple(stay)


def _joints_across(problem: Problem) -> set[str]:
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
    joints: set[str] = set()
    for term in problem.terms:
        if isinstance(term, HalfEnd) and isinstance(term.term, TerminalState):
            goal = term.reduction.drop_q(np.asarray(term.term.q, dtype=float))
            apart = np.abs(goal - problem.initial_q) > TASK
            joints.update(joints_with(problem.robot.model, apart))
    return joints


@dataclass(frozen=True)
class Asymmetry:
    """Largest difference between a part of the task and its mirror image, and the name of that part."""

    difference: float
    where: str


def require_symmetric(problem: Problem, mirror: Mirror, images: Sequence[int]) -> Asymmetry:
    """Return how far a task is from its mirror image; raises `InputError` that names what is asymmetric.

    ``images`` are the indices of the contacts' images. The plane is y = initial_q[1]; the base heads along x.
    """
    asymmetries = [_start(problem, mirror)]
    for phase in problem.schedule.phases:
        asymmetries.append(_contacts(problem, phase, images))
    groups: dict[tuple[object, ...], list[TermInstance]] = {}
    for instance in TermReader(problem).every():
        place = instance.node.index if instance.node is not None else instance.context.place
        groups.setdefault((instance.term.name, instance.phase, place), []).append(instance)
    asymmetries += [_terms(problem, group, mirror, images) for group in groups.values()]
    return max(asymmetries, key=lambda entry: entry.difference)


def _refuse(what: str, difference: float) -> InputError:
    return InputError(f"{what} is not its own mirror image: off by {difference:.2g}", "a symmetric task")


def _start(problem: Problem, mirror: Mirror) -> Asymmetry:
    robot, q = problem.robot, problem.initial_q
    rotation = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
    if not rotation[1, 1] > 1 - HEADING**2:
        raise InputError("the base does not head along the world's x axis, level", "roll and yaw zero")
    image = mirrored_configuration(robot, mirror, q, float(q[1]))
    apart = float(np.abs(pin.difference(robot.model, q, image)).max())
    index, sign = mirrored_rows(robot, mirror)
    moving = float(np.abs(problem.initial_v - sign * problem.initial_v[index]).max())
    if not max(apart, moving) <= TASK:
        raise _refuse("the start", max(apart, moving))
    return Asymmetry(max(apart, moving), "the start")


def _contacts(problem: Problem, phase: Phase, images: Sequence[int]) -> Asymmetry:
    """Compare the surface of each contact in a phase with the mirror image of its partner's surface."""
    if phase.patches or not isinstance(problem.terrain, FlatGround):
        raise InputError(
            f"phase '{phase.name}' has patches, or its ground is not one plane",
            "footholds and planes, whose mirror images are compared",
        )
    robot, y0, worst = problem.robot, float(problem.initial_q[1]), 0.0
    names = [contact.name for contact in robot.contacts]
    for name in phase.contacts:
        image = names[images[names.index(name)]]
        if image not in phase.contacts:
            raise InputError(
                f"contact '{name}' of phase '{phase.name}' has no mirror image '{image}' there",
                "contacts in pairs",
            )
        surface, other = (
            phase.surface(entry, problem.terrain).plane_at(problem.initial_q[:3]) for entry in (name, image)
        )
        point = REFLECTION * surface.point + np.array([0.0, 2 * y0, 0.0])
        apart = [
            float(np.abs(REFLECTION * surface.normal - other.normal).max()),
            abs(surface.friction - other.friction),
        ]
        apart.append(abs(float(other.distance(point))) / robot.length)
        if surface.bilateral != other.bilateral or not max(apart) <= TASK:
            raise _refuse(f"the surface under '{name}' in phase '{phase.name}'", max(apart))
        worst = max(worst, *apart)
    return Asymmetry(worst, f"surfaces of phase '{phase.name}'")


def _terms(problem: Problem, group: list[TermInstance], mirror: Mirror, images: Sequence[int]) -> Asymmetry:
    """Compare all terms of one name at one place, at random inputs and at their mirror images."""
    where = f"{group[0].term.name} of phase '{problem.schedule.phases[group[0].phase].name}'"
    filled = [instance for instance in group if instance.expression.numel()]
    if not filled:
        return Asymmetry(0.0, where)
    functions, generator = [instance.function() for instance in filled], np.random.default_rng(0)
    worst = 0.0
    for _ in range(STATES):
        inputs = _mirrored_inputs(problem, filled[0], mirror, images, generator)
        sides = [[np.array(function(z)).ravel() for function in functions] for z in inputs]
        here, image = (_comparable(filled, values) for values in sides)
        worst = max(worst, float((np.abs(here - image) / (1.0 + np.abs(here))).max()))
    uses_dynamics = any(instance.uses_dynamics for instance in filled)
    if not worst <= TASK + (ASYMMETRY_GAIN * mirror.asymmetry if uses_dynamics else 0.0):
        raise _refuse(where, worst)
    return Asymmetry(0.0 if uses_dynamics else worst, where)


def _comparable(group: list[TermInstance], values: list[np.ndarray]) -> np.ndarray:
    """Return values that do not depend on the order of rows: cost, norm of equations, sorted slacks."""
    costs, slacks, equations = 0.0, [np.zeros(0)], [np.zeros(0)]
    for instance, value in zip(group, values, strict=True):
        if instance.rows is None:
            costs += float(value.sum())
            continue
        lower, upper = (bound / instance.rows.unit for bound in (instance.rows.lower, instance.rows.upper))
        equal = lower == upper
        slacks += [(value - lower)[~equal], (upper - value)[~equal]]
        equations.append((value - lower)[equal])
    every = np.concatenate(slacks)
    norm = np.linalg.norm(np.concatenate(equations))
    return np.array([costs, norm, *np.sort(every[np.isfinite(every)])])


def _mirrored_inputs(
    problem: Problem,
    instance: TermInstance,
    mirror: Mirror,
    images: Sequence[int],
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return random inputs z of a place, near the start, and their mirror image."""
    robot, context = problem.robot, instance.context
    coordinates, y0 = context.coordinates, float(problem.initial_q[1])
    index, sign = mirrored_rows(robot, mirror)
    q = pin.integrate(robot.model, problem.initial_q, generator.uniform(-0.5, 0.5, robot.nv))
    parts: list[np.ndarray] = []
    mirrored: list[np.ndarray] = []
    still = np.zeros(robot.nv)
    for inputs, configuration in ((parts, q), (mirrored, mirrored_configuration(robot, mirror, q, y0))):
        node = coordinates.node_from_pinocchio(configuration, still)
        inputs.append(node[: len(node) - robot.nv])
    if context.place is not Place.NODE:
        _as_local(coordinates.additive_index, coordinates.n_rotations, robot.nv, parts)
        _as_local(coordinates.additive_index, coordinates.n_rotations, robot.nv, mirrored)
    for _ in range(2 - (context.place is Place.NODE) - (problem.actuation == "velocity")):
        rate = generator.uniform(-1, 1, robot.nv)
        parts.append(rate)
        mirrored.append(sign * rate[index])
    if context.place is not Place.NODE:
        wrenches = {c.name: generator.uniform(-1, 1, c.dimension) for c in context.contacts}
        parts += [wrenches[c.name] * robot.weight for c in context.contacts]
        names = [contact.name for contact in robot.contacts]
        for contact in context.contacts:
            partner = wrenches[names[images[names.index(contact.name)]]]
            mirrored.append(TWIST[: len(partner)] * partner * robot.weight)
    n_time_scales = context.z.numel() - sum(len(part) for part in parts)
    return np.concatenate([*parts, np.ones(n_time_scales)]), np.concatenate(
        [*mirrored, np.ones(n_time_scales)]
    )


def _as_local(additive: np.ndarray, n_rotations: int, nv: int, parts: list[np.ndarray]) -> None:
    node = parts.pop()
    xi = np.zeros(nv)
    xi[additive] = node[4 * n_rotations :]
    parts += [node[: 4 * n_rotations], xi]
