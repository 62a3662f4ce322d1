"""Four point contacts at the corners of a rectangle on one link, merged into one surface contact.

Because the link is rigid, their 12 rows have rank 6. A surface contact has 6 rows. Keeping its centre of
pressure inside the rectangle is equivalent to four unilateral corners. Its friction is that of `SoleCone`,
the cone spanned by corners with friction pyramids along the sides (Caron, Pham, Nakamura, ICRA 2015).
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.motion.grid import interpolated
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.extraction import contact_activity, described_robot
from trajopt.terms.friction import ContactConstraint, FrictionCone, FrictionPyramid, SoleCone
from trajopt.terms.interfaces import Term

# Corners may deviate from a rectangle by this fraction of its diagonal: models are rounded.
RECTANGLE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Sole:
    """A rectangle: its surface contact, and its corners' names and positions (4, 3) in the sole frame, m."""

    contact: Contact
    corners: tuple[str, ...]
    places: np.ndarray
    joint: int
    placement: pin.SE3


@dataclass(frozen=True, kw_only=True, eq=False)
class Soles:
    """The problem with soles instead of corners, and the map of its solutions back to corners."""

    problem: Problem
    soles: tuple[Sole, ...]

    def lift(self, solution: Solution, original: Problem) -> Solution:
        """Return the solution with forces at the corners, as even as their friction pyramids allow."""
        robot, on_soles = original.robot, self.problem.robot
        model, data = on_soles.model, on_soles.model.createData()
        names = [contact.name for contact in on_soles.contacts]
        f = np.zeros((solution.n_samples, len(robot.contacts), 6))
        for k in np.flatnonzero(solution.collocation):
            pin.framesForwardKinematics(model, data, solution.q[k])
            forces = {n: solution.f[k, row] for row, n in enumerate(names)}
            for sole in self.soles:
                turn = data.oMf[model.getFrameId(sole.contact.frame)].rotation
                forces |= _corner_forces(sole, turn, forces.pop(sole.contact.name), original)
            f[k] = [forces[contact.name] for contact in robot.contacts]
        return replace(
            solution,
            description=replace(solution.description, **described_robot(original)),
            model=robot.limited_model(),
            f=interpolated(solution, f),
            active=contact_activity(robot, original.schedule)[solution.phase],
        )


def _corner_forces(
    sole: Sole, turn: np.ndarray, wrench: np.ndarray, problem: Problem
) -> dict[str, np.ndarray]:
    """Distribute a wrench to forces (6,) at the corners, world axes, on friction pyramids by NNLS."""
    if not wrench.any():
        return {name: np.zeros(6) for name in sole.corners}
    mu = problem.terrain.friction / np.sqrt(2)
    rays = np.array([[sx * mu, sy * mu, 1.0] for sx in (-1, 1) for sy in (-1, 1)])
    local = np.concatenate([turn.T @ wrench[:3], turn.T @ wrench[3:]])
    columns = np.array([[*ray, *np.cross(place, ray)] for place in sole.places for ray in rays]).T
    # A small regularisation evens out the forces where the distribution is not unique.
    even = 1e-6 * np.eye(columns.shape[1])
    from scipy.optimize import nnls  # takes a while to load

    weights, _ = nnls(np.vstack([columns, even]), np.concatenate([local, np.zeros(len(even))]))
    parts = weights.reshape(len(sole.corners), len(rays)) @ rays
    return {
        name: np.concatenate([turn @ part, np.zeros(3)])
        for name, part in zip(sole.corners, parts, strict=True)
    }


def with_soles(problem: Problem) -> Soles | None:
    """Return the problem with one sole for each set of four corners that act together, or None without any.

    Corners that a term names, or that have a radius or a surface of their own, remain points.
    """
    if problem.dynamics is not None or problem.modes or any(p.impact for p in problem.schedule.phases):
        return None
    soles = _soles(problem)
    if not soles:
        return None
    robot, merged = problem.robot, {name for sole in soles for name in sole.corners}
    model = pin.Model(robot.model)
    for sole in soles:
        model.addFrame(
            pin.Frame(sole.contact.frame, sole.joint, 0, sole.placement, pin.FrameType.OP_FRAME), False
        )
    contacts = [c for c in robot.contacts if c.name not in merged] + [sole.contact for sole in soles]
    phases = tuple(_phase(phase, soles) for phase in problem.schedule.phases)
    terms: list[Term] = []
    for term in problem.terms:
        if isinstance(term, FrictionCone | FrictionPyramid):  # for the remaining points, and for the soles
            cone = SoleCone(during=term.during, friction=term.friction)
            terms += [replace(term, contacts=None), cone]
        else:
            terms.append(term)
    return Soles(
        problem=replace(
            problem,
            robot=replace(robot, model=model, contacts=tuple(contacts), given_length=robot.length),
            schedule=Schedule(phases),
            terms=tuple(terms),
        ),
        soles=tuple(soles),
    )


def _phase(phase: Phase, soles: list[Sole]) -> Phase:
    contacts, footholds = list(phase.contacts), dict(phase.footholds)
    for sole in soles:
        if sole.corners[0] in contacts:
            contacts = [name for name in contacts if name not in sole.corners] + [sole.contact.name]
            places = [footholds.pop(name) for name in sole.corners if name in footholds]
            if len(places) == len(sole.corners):
                footholds[sole.contact.name] = np.mean(places, axis=0)
    return replace(phase, contacts=tuple(contacts), footholds=footholds)


def _soles(problem: Problem) -> list[Sole]:
    robot, model = problem.robot, problem.robot.model
    by_joint: dict[int, list[Contact]] = {}
    for contact in robot.contacts:
        bare = contact.kind == "point" and contact.dimension == 3 and not contact.radius
        if bare and not _named(problem, contact.name):
            joint = int(model.frames[model.getFrameId(contact.frame)].parentJoint)
            by_joint.setdefault(joint, []).append(contact)
    data = model.createData()
    pin.framesForwardKinematics(model, data, problem.initial_q)
    soles = []
    for joint, corners in by_joint.items():
        names, phases = [c.name for c in corners], problem.schedule.phases
        # Active in some phase; in every phase all four or none are active, and all or none have footholds.
        counts = {sum(name in phase.contacts for name in names) for phase in phases}
        places = {sum(name in phase.footholds for name in names) for phase in phases}
        together = {4} <= counts <= {0, 4} and places <= {0, 4}
        if joint > 0 and len(corners) == 4 and together:
            sole = _sole(problem, data.oMi[joint], joint, corners)
            if sole is not None:
                soles.append(sole)
    return soles


def _named(problem: Problem, name: str) -> bool:
    """Return whether a term names the contact, or a phase gives it a surface of its own."""
    if any(phase.own_surface(name) is not None for phase in problem.schedule.phases):
        return True
    of_contacts = [term for term in problem.terms if isinstance(term, ContactConstraint)]
    named = any(getattr(term, "contact", None) == name for term in problem.terms)
    return named or any(name in (term.contacts or ()) for term in of_contacts)


def _sole(problem: Problem, body: pin.SE3, joint: int, corners: list[Contact]) -> Sole | None:
    """Return the rectangle of four corners, z axis upwards at the start, or None if they form none."""
    model = problem.robot.model
    points = np.array([model.frames[model.getFrameId(c.frame)].placement.translation for c in corners])
    for order in itertools.permutations(range(1, 4)):
        along, across, opposite = (points[i] - points[0] for i in order)
        diagonal = float(np.linalg.norm(opposite))
        off = max(
            float(np.linalg.norm(along + across - opposite)), abs(along @ across) / max(diagonal, 1e-300)
        )
        if not off <= RECTANGLE * diagonal or np.linalg.norm(along) < np.linalg.norm(across):
            continue
        size = np.linalg.norm(along) / 2, np.linalg.norm(across) / 2
        x, normal = along / (2 * size[0]), np.cross(along, across)
        normal /= np.linalg.norm(normal)
        if (body.rotation @ normal) @ problem.terrain.surface.plane_at(body.translation).normal < 0:
            normal = -normal
        frame = pin.SE3(np.column_stack([x, np.cross(normal, x), normal]), points.mean(axis=0))
        names = tuple(c.name for c in corners)
        name = f"sole of {', '.join(names)}"
        contact = Contact(
            frame=name, name=name, kind="surface", half_length=float(size[0]), half_width=float(size[1])
        )
        places = np.array([frame.actInv(point) for point in points])
        return Sole(contact=contact, corners=names, places=places, joint=joint, placement=frame)
    return None
