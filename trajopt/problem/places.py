"""Whether the start, footholds and goals are possible: tested before solving, with the check's tolerances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_content import frame_content, joint_kind
from trajopt.errors import InputError
from trajopt.problem.validation import require_limits
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.robot import Robot
from trajopt.robot.validation import require_configuration
from trajopt.schedule.moment import Moment, Target
from trajopt.schedule.schedule import Schedule
from trajopt.terms.frames import FrameHeight
from trajopt.terms.interfaces import PointConstraint, Term
from trajopt.terms.terminal import TerminalState
from trajopt.terrain.surface import SAME_PLANE, Surface
from trajopt.terrain.terrain import Ground

# Joints that rotate about a point fixed in their parent: distances from it are constant.
ROTARY_JOINTS = ("RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "RevoluteUnaligned", "RevoluteUnboundedUnaligned",
           "Spherical", "SphericalZYX")  # fmt: skip
# Tolerances of the check: distance of contacts from their ground where they begin, m; tilt of soles, rad.
CONTACT_GAP, SOLE_TILT = 1e-3, 1e-2
# In a goal, contacts may be this fraction of the robot's length away from where they stand, and places may be
# farther apart than the links reach by as much: the drift of feet that the check allows for a 1 m robot.
PLACE_SLACK = 1e-3
_Places = Mapping[str, np.ndarray]
_Goal = tuple[str, Target]  # the name of its term, and the target


@dataclass(frozen=True)
class LinkPoint:
    """A point (3,) m in the frame of a joint; for joint 0, in the world."""

    joint: int
    point: np.ndarray

    @classmethod
    def of_frame(cls, model: pin.Model, frame: str) -> LinkPoint:
        """The origin of a frame. Raises `InputError` that lists close names."""
        frame_content(model, frame)
        place = model.frames[model.getFrameId(frame)]
        return cls(int(place.parentJoint), np.array(place.placement.translation))

    def root(self, model: pin.Model) -> LinkPoint:
        """Where the first joint on the path from the root to it is attached, in the world."""
        way = _to_root(model, self.joint)
        if len(way) == 1:
            return self
        return LinkPoint(0, np.array(model.jointPlacements[way[-2]].translation))


def longest_between(model: pin.Model, one: LinkPoint, other: LinkPoint) -> float:
    """Upper bound on the distance in m between two places, over all configurations; inf where there is none.

    The bound is the sum of the lengths from joint to joint on the path between them. Prismatic joints have no
    bound, whatever their limits.
    """
    ancestors = set(_to_root(model, one.joint))
    top = next(joint for joint in _to_root(model, other.joint) if joint in ancestors)
    (first, way), (second, back) = (_climb(model, place, top) for place in (one, other))
    return float(np.linalg.norm(first - second)) + way + back


def _to_root(model: pin.Model, joint: int) -> list[int]:
    path = [joint]
    while path[-1]:
        path.append(int(model.parents[path[-1]]))
    return path


def _climb(model: pin.Model, place: LinkPoint, top: int) -> tuple[np.ndarray, float]:
    """Point of body ``top`` where the branch to ``place`` is attached, and the length from there to it."""
    joint, point, length = place.joint, place.point, 0.0
    while joint != top:
        turns = joint_kind(model, joint) in ROTARY_JOINTS
        length += float(np.linalg.norm(point)) if turns else np.inf
        joint, point = int(model.parents[joint]), np.array(model.jointPlacements[joint].translation)
    return point, length


@dataclass(frozen=True, kw_only=True)
class Stances:
    """Where the contacts of a schedule stand.

    For each phase, ``grounds`` holds what each active contact touches, and is empty for a model that holds no
    contacts; ``places`` holds the positions (3,) in m of the contacts that are known before solving.
    """

    robot: Robot
    schedule: Schedule
    grounds: tuple[Mapping[str, Ground], ...]
    places: tuple[_Places, ...]

    def index(self, phase: str | None) -> int:
        """Index of the phase of that name, or of the last phase for None."""
        return len(self.places) - 1 if phase is None else self.schedule.names.index(phase)

    def at(self, moment: Moment) -> _Places:
        """Positions of the contacts that stand at a moment; between two phases, those of both."""
        held = [self.held(index) for index in self.schedule.phases_at(moment)]
        return {name: place for places in held for name, place in places.items()}

    def held(self, index: int) -> _Places:
        """Known positions of a phase's contacts without those that roll away from where they began."""
        places = self.places[index]
        return {name: place for name, place in places.items() if not self.robot.contact(name).rolling}


def require_places(
    stances: Stances, start: np.ndarray | None, terms: Sequence[Term], rows: Sequence[PointConstraint]
) -> None:
    """Raise `InputError` for a start, a foothold or a goal that no motion can have.

    ``start`` (nq,) is None if it is free; ``rows`` are the constraints at collocation points, among them the
    limits. `trajopt.problem.bodies` checks whether bodies are clear of each other there.
    """
    require_footholds(stances)
    require_apart(stances)
    if start is not None:
        require_start_contacts(stances, start)
    for term in terms:
        if isinstance(term, TerminalState):
            require_configuration(stances.robot.model, np.array(term.q, dtype=float), f"q of {term.name}")
    goals = [(term.name, target) for term in terms for target in term.targets()]
    require_postures(stances, goals, rows)
    require_reach(stances, goals)
    require_heights(stances, terms)


def require_start_contacts(stances: Stances, q: np.ndarray) -> None:
    """Require contacts of the first phase to be on their ground, and soles to be flat on it."""
    robot, poses = stances.robot, contact_poses(stances.robot, q)
    allowed = "or a first phase without it"
    for name, ground in stances.grounds[0].items():
        contact, where = robot.contact(name), "initial_q has"
        _require_gap(where, contact, ground, poses[name].translation, allowed)
        if contact.kind == "point" or not isinstance(ground, Surface):
            continue
        chord = float(np.linalg.norm(poses[name].rotation[:, 2] - ground.normal))
        tilt = 2 * math.asin(min(chord / 2, 1.0))
        if tilt > SOLE_TILT:
            raise InputError(
                f"{where} sole '{name}' tilted by {tilt:.4g} rad on its ground",
                f"allowed: up to {SOLE_TILT:g} rad, {allowed}",
            )


def _require_gap(where: str, contact: Contact, ground: Ground, place: np.ndarray, allowed: str) -> None:
    gap = contact.gap(ground, place)
    if not abs(gap) <= CONTACT_GAP:
        raise InputError(
            f"{where} contact '{contact.name}' {_side(gap)} its ground",
            f"allowed: within {CONTACT_GAP:g} m, {allowed}",
        )


def _side(gap: float) -> str:
    return f"{abs(gap):.4g} m {'above' if gap > 0 else 'below'}"


def require_footholds(stances: Stances) -> None:
    """Require footholds on their ground; contacts that stand already must have them where they stand."""
    for index, phase in enumerate(stances.schedule.phases):
        for name, foothold in phase.footholds.items():
            what, ground = f"foothold of '{name}' in phase '{phase.name}'", stances.grounds[index].get(name)
            contact = stances.robot.contact(name)
            gap = 0.0 if ground is None else contact.gap(ground, foothold) + contact.radius
            allowed = SAME_PLANE if isinstance(ground, Surface) else CONTACT_GAP
            if not abs(gap) <= allowed:
                raise InputError(f"{what} is {_side(gap)} its ground", f"allowed: within {allowed:g} m")
            lands = name in stances.schedule.new_contacts(index)
            stands = foothold if lands else stances.places[index].get(name, foothold)
            off = float(np.linalg.norm(foothold - stands)) - (0.0 if lands else contact.radius)
            if off > CONTACT_GAP:
                raise InputError(
                    f"{what} is {off:.4g} m from where the contact stands already",
                    f"allowed: within {CONTACT_GAP:g} m, or a phase before it without the contact",
                )


def require_postures(stances: Stances, goals: Sequence[_Goal], rows: Sequence[PointConstraint]) -> None:
    """Require goal configurations within limits, with contacts where they stand or on their ground.

    Goals constrain only the directions that contacts leave free, so a goal that contradicts the contacts
    would be dropped silently.
    """
    robot = stances.robot
    for term, target in goals:
        if target.q is None:
            continue
        index, where = stances.index(target.at.phase), f"q of {term} has"
        name = stances.schedule.names[index]
        require_configuration(robot.model, target.q, f"q of {term}")
        limits = [limit for limit in rows if limit.acts_in(name)]
        require_limits(f"in q of {term}", robot, target.q, np.zeros(robot.nv), limits)
        for contact, pose in contact_poses(robot, target.q).items():
            place, ground = stances.held(index).get(contact), stances.grounds[index].get(contact)
            off = 0.0 if place is None else float(np.linalg.norm(pose.translation - place))
            if off > PLACE_SLACK * robot.length:
                raise InputError(
                    f"{where} '{contact}' {off:.4g} m from where it stands in phase '{name}'",
                    "allowed: a configuration in which contacts are where they stand, or landed",
                )
            if place is None and ground is not None:
                _require_gap(
                    where, robot.contact(contact), ground, pose.translation, "or a last phase without it"
                )


def require_apart(stances: Stances) -> None:
    """Require contacts that stand at once to be no farther apart than the links between them reach."""
    for index, phase in enumerate(stances.schedule.names):
        places = stances.held(index)
        feet = _feet(stances.robot, places)
        for one, other in combinations(places, 2):
            what = f"contacts '{one}' and '{other}' stand in phase '{phase}'"
            _require_near(stances.robot, what, (feet[one], feet[other]), places[one] - places[other])


def require_reach(stances: Stances, goals: Sequence[_Goal]) -> None:
    """Require goal positions within reach of standing contacts and of a fixed base.

    Only goals that no posture reaches are rejected, not those out of reach because of limits or other goals.
    """
    robot = stances.robot
    for term, target in goals:
        if target.frame is None or target.position is None:
            continue
        frame = LinkPoint.of_frame(robot.model, target.frame)
        for name, point, place in _anchors(robot, frame, stances.at(target.at)):
            what = f"{term} has '{target.frame}' and {name}"
            _require_near(robot, what, (point, frame), target.position - place)


def require_heights(stances: Stances, terms: Sequence[Term]) -> None:
    """Require heights of frames within reach of standing contacts and of a fixed base."""
    robot = stances.robot
    for term in terms:
        if isinstance(term, FrameHeight) and math.isfinite(term.height):
            frame = LinkPoint.of_frame(robot.model, term.frame)
            for name, point, place in _anchors(robot, frame, stances.at(term.at)):
                over = (term.height - float(place[2])) * (-1 if term.below else 1)
                what = f"{term.name} has '{term.frame}' and {name}"
                _require_near(robot, what, (point, frame), np.array([0.0, 0.0, max(over, 0.0)]))


def _anchors(robot: Robot, frame: LinkPoint, places: _Places) -> Iterator[tuple[str, LinkPoint, np.ndarray]]:
    """Points to which links tie a frame, (3,) in m, world: standing contacts, and its fixed first joint."""
    for name, point in _feet(robot, places).items():
        yield f"contact '{name}'", point, places[name]
    root = frame.root(robot.model)
    yield "the place where its first joint is fixed", root, root.point


def _feet(robot: Robot, places: _Places) -> dict[str, LinkPoint]:
    return {name: LinkPoint.of_frame(robot.model, robot.contact(name).frame) for name in places}


def _require_near(robot: Robot, what: str, ends: tuple[LinkPoint, LinkPoint], apart: np.ndarray) -> None:
    longest, distance = longest_between(robot.model, *ends), float(np.linalg.norm(apart))
    if distance > longest + PLACE_SLACK * robot.length:
        raise InputError(
            f"{what} {distance:.4g} m apart",
            f"allowed: up to {longest:.4g} m, all links between them in line",
        )
