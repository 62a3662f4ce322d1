"""Constraints at nodes: where a contact lands, how high a foot swings, where the motion ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.context import Context
from trajopt.errors import InputError
from trajopt.manifold import Coordinates
from trajopt.model_quantities import contact_jacobian
from trajopt.robot import Contact, Robot
from trajopt.rotations import rotation_matrix
from trajopt.schedule import FlatGround, Phase
from trajopt.surface import Surface
from trajopt.term_interfaces import Rows, Term
from trajopt.units import Units

# Singular values of a contact Jacobian below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True)
class NodePlace:
    """A node within its phase: ``index`` of ``count`` intervals; ``last`` of the whole schedule.

    ``ends_schedule``: the phase is the last one.
    """

    phase: Phase
    index: int
    count: int
    last: bool
    ends_schedule: bool = True

    @property
    def fraction(self) -> float:
        """Fraction of the phase's duration at this node, 0 to 1."""
        return self.index / self.count


@dataclass(frozen=True, kw_only=True)
class NodeConstraint(Term, ABC):
    """A constraint at some nodes; nodes of one phase at which the same constraints act share a function."""

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the constraint acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        """Rows at the node; only bounds and parameter values may depend on ``place``."""


def rotation_error(target: ca.SX, rotation: ca.SX) -> ca.SX:
    """2 tan(angle / 2) times the axis of target^T rotation, (3,): smooth, zero only where equal.

    Twice the Rodrigues vector vee(R - R^T) / (1 + tr R); infinite at an angle of pi, so no false
    zero exists there.
    """
    error = ca.mtimes(target.T, rotation)
    vee = ca.vertcat(error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1])
    return 2 * vee / (1 + ca.trace(error))


def along_normal(context: Context, surface: Surface, columns: ca.SX) -> ca.SX:
    """Components (1, n) along a surface's normal of columns (3, n) in world axes.

    On level ground the third row; elsewhere the normal is a parameter.
    """
    return columns[2, :] if surface.is_level else ca.mtimes(context.parameter(surface.normal).T, columns)


@dataclass(frozen=True, kw_only=True)
class ContactLanding(NodeConstraint):
    """New contacts of a phase lie on their surface (or on their footholds) and do not move.

    The surface is the phase's for that contact, else the terrain; a sole lies flat on it. Contacts that
    are ``held`` through an impact do not move after it either.
    """

    phase: str
    contacts: tuple[str, ...]
    terrain: FlatGround
    held: tuple[str, ...] = ()

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == self.phase and place.index == 0

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        expressions, targets, scales = [], [], []
        for name in self.contacts:
            contact = context.robot.contact(name)
            frame, held = context.frame(contact.frame), context.held_rows(contact)
            foothold, surface = place.phase.footholds.get(name), place.phase.surface(name, self.terrain)
            movable = [row for row in held if row < 3]
            if foothold is not None:
                expressions.append(frame.position[movable])
                targets.append(foothold[movable])
            elif 2 in held or (movable and not surface.is_level):
                expressions.append(along_normal(context, surface, frame.position))
                targets.append(np.array([surface.height]))
            else:
                continue
            scales.append(np.full(len(targets[-1]), units.length))
            tilting = _tilting_axes(contact, held)
            if tilting:
                expressions.append(along_normal(context, surface, frame.rotation[:, tilting]).T)
                targets.append(np.zeros(len(tilting)))
                scales.append(np.ones(len(tilting)))
        if context.actuation != "velocity":
            for name in (*self.contacts, *self.held):
                contact = context.robot.contact(name)
                rows = list(context.held_rows(contact))
                if rows:
                    expressions.append(context.frame(contact.frame).velocity[rows])
                    targets.append(np.zeros(len(rows)))
                    scales.append(units.twist[rows])
        bound = np.concatenate(targets)
        return Rows.create(ca.vertcat(*expressions), bound, bound, np.concatenate(scales))


def _tilting_axes(contact: Contact, held: tuple[int, ...]) -> list[int]:
    """Axes of a sole (0: x, 1: y) that must lie in its surface: of a planar robot the one in its plane."""
    if contact.dimension == 6:
        return [0, 1][: sum(row > 2 for row in held)]
    return [0 if row == 4 else 1 for row in held if row in (3, 4)]


@dataclass(frozen=True, kw_only=True)
class SwingClearance(NodeConstraint):
    """Contact frames that are not in contact stay above the terrain at the nodes inside a phase.

    The least distance from the terrain is ``height`` times 4 s (1 - s), s the fraction of the phase, m.
    """

    height: float
    terrain: FlatGround

    def __post_init__(self) -> None:
        if not (np.isfinite(self.height) and self.height >= 0):
            raise InputError(f"swing clearance is {self.height:g} m", "allowed: finite and >= 0")

    def acts_at(self, place: NodePlace) -> bool:
        return 0 < place.index < place.count and self.acts_in(place.phase.name)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        swing = [c for c in context.robot.contacts if c.name not in place.phase.contacts]
        ground = self.terrain.surface
        heights = [along_normal(context, ground, context.frame(c.frame).position) for c in swing]
        least = ground.height + self.height * 4 * place.fraction * (1 - place.fraction)
        return Rows.create(ca.vertcat(*heights), least, np.inf, units.length)


def nearest_node(place: NodePlace, fraction: float) -> int:
    """Index of a phase's own node nearest to ``fraction``: the last node of all but the last is the next's."""
    nearest = round(fraction * place.count)
    return nearest if place.ends_schedule else min(nearest, place.count - 1)


@dataclass(frozen=True, kw_only=True)
class FrameHeight(NodeConstraint):
    """A frame at least ``height`` m high at the node nearest to ``fraction`` of the phase ``phase``.

    Of the phase's own nodes: the last one of all but the last phase belongs to the next.
    """

    frame: str
    height: float
    phase: str
    fraction: float = 0.5

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == self.phase and place.index == nearest_node(place, self.fraction)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(context.frame(self.frame).position[2], self.height, np.inf, units.length)


@dataclass(frozen=True, kw_only=True)
class FramePose(NodeConstraint):
    """A frame's pose at the end: ``position`` (3,) m and ``rotation`` (3, 3), world; either may be None."""

    frame: str
    position: np.ndarray | None = None
    rotation: np.ndarray | None = None

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        frame = context.frame(self.frame)
        expressions, targets, scales = [], [], []
        if self.position is not None:
            expressions.append(frame.position)
            targets.append(np.asarray(self.position, dtype=float))
            scales.append(np.full(3, units.length))
        if self.rotation is not None:
            expressions.append(rotation_error(context.parameter(self.rotation), frame.rotation))
            targets.append(np.zeros(3))
            scales.append(np.ones(3))
        bound = np.concatenate(targets)
        return Rows.create(ca.vertcat(*expressions), bound, bound, np.concatenate(scales))


@dataclass(frozen=True, kw_only=True)
class FrameVelocity(NodeConstraint):
    """A frame's velocity at the end: ``velocity`` (6,), linear m/s and angular rad/s, world axes."""

    frame: str
    velocity: np.ndarray

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(context.frame(self.frame).velocity, self.velocity, self.velocity, units.twist)


def free_directions(robot: Robot, q: np.ndarray, contacts: Sequence[str]) -> np.ndarray:
    """Orthonormal basis (nv, n) of the local rates that active contacts leave free at q (nq,).

    The null space of the contact Jacobian over the rates of the local coordinates (world linear and
    body angular velocity of a free-flyer). To ask "at rest" or "there" of these directions only is
    what keeps the rows independent of the contact rows.
    """
    if not contacts:
        return np.eye(robot.nv)
    coordinates = Coordinates(robot.model)
    to_pinocchio = np.column_stack(
        [coordinates.node_to_pinocchio(_node_with_rate(coordinates, q, i))[1][0] for i in range(robot.nv)]
    )
    places = [(contact.frame, contact.rows) for contact in map(robot.contact, contacts)]
    jacobian = contact_jacobian(robot.model, q, places) @ to_pinocchio
    _, singular, vt = np.linalg.svd(jacobian)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return vt[rank:].T


def _node_with_rate(coordinates: Coordinates, q: np.ndarray, index: int) -> np.ndarray:
    node = coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))
    node[len(node) - coordinates.nv + index] = 1.0
    return node


@dataclass(frozen=True, kw_only=True)
class TerminalState(NodeConstraint):
    """The final configuration is ``q`` (nq,), in the directions that active contacts leave free."""

    q: np.ndarray

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return _free_rows(context, place, self.q, _difference(context, self.q) / units.position)


def _free_rows(context: Context, place: NodePlace, q: np.ndarray, quantity: ca.SX) -> Rows:
    """A dimensionless quantity (nv,) vanishes in the directions that active contacts leave free at q."""
    basis = free_directions(context.robot, q, place.phase.contacts)
    return Rows.create(ca.mtimes(context.parameter(basis).T, quantity), 0, 0, 1.0)


def _difference(context: Context, q: np.ndarray) -> ca.SX:
    """Local coordinates (nv,) of the context's configuration relative to q."""
    coordinates = context.coordinates
    goal = coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))
    n4, additive = 4 * coordinates.n_rotations, coordinates.additive_index
    error = context.xi - 0
    target = context.parameter(goal[n4 : n4 + len(additive)])
    for row, index in enumerate(additive):
        error[int(index)] = context.xi[int(index)] - target[row]
    for i in range(coordinates.n_rotations):
        quaternion = context.parameter(goal[4 * i : 4 * i + 4])
        three = coordinates.rotation_index[3 * i : 3 * i + 3]
        relative = rotation_error(
            rotation_matrix(quaternion), rotation_matrix(context.rotations[4 * i : 4 * i + 4])
        )
        for row, index in enumerate(three):
            error[int(index)] = relative[row]
    return error


@dataclass(frozen=True, kw_only=True)
class TerminalRest(NodeConstraint):
    """The motion ends at rest, in the directions that active contacts leave free at ``q`` (nq,)."""

    q: np.ndarray

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return _free_rows(context, place, self.q, context.dxi / units.velocity)
