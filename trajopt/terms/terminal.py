"""Constraints at nodes: where a contact lands, how high a foot swings, where the motion ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.dynamics.rotations import rotation_matrix
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.robot.validation import UNIT_SLACK, require_configuration
from trajopt.schedule.targets import Target
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows
from trajopt.terms.landing import ContactLanding, SwingClearance, along_normal
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace, nearest_node

__all__ = [
    "ContactLanding",
    "FrameHeight",
    "FramePose",
    "FrameVelocity",
    "NodeConstraint",
    "NodePlace",
    "SwingClearance",
    "TerminalRest",
    "TerminalState",
    "TerminalVelocity",
    "along_normal",
    "free_directions",
    "nearest_node",
    "rotation_error",
]

# Singular values of a contact Jacobian below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-6


def rotation_error(target: ca.SX, rotation: ca.SX) -> ca.SX:
    """2 tan(angle / 2) times the axis of target^T rotation, (3,): smooth, zero only where equal.

    Twice the Rodrigues vector vee(R - R^T) / (1 + tr R); infinite at an angle of pi, so no false
    zero exists there.
    """
    error = ca.mtimes(target.T, rotation)
    vee = ca.vertcat(error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1])
    return 2 * vee / (1 + ca.trace(error))


@dataclass(frozen=True, kw_only=True)
class FrameHeight(NodeConstraint):
    """A frame at least ``height`` m high at the node nearest to ``fraction`` of the phase ``phase``.

    ``below``: at most that high. Of the phase's own nodes: the last one of all but the last phase belongs to
    the next.
    """

    frame: str
    height: float
    phase: str
    fraction: float = 0.5
    below: bool = False

    def acts_at(self, place: NodePlace) -> bool:
        return place.phase.name == self.phase and place.index == nearest_node(place, self.fraction)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        bounds = (-np.inf, self.height) if self.below else (self.height, np.inf)
        return Rows.create(context.frame(self.frame).position[2], *bounds, units.length)


@dataclass(frozen=True, kw_only=True)
class FramePose(NodeConstraint):
    """A frame's pose at the end: ``position`` (3,) m and ``rotation`` (3, 3), world; either may be None.

    ``phase``: a waypoint, where that phase begins, instead of the end of the schedule. Raises InputError.
    """

    frame: str
    position: np.ndarray | None = None
    rotation: np.ndarray | None = None
    phase: str | None = None

    def __post_init__(self) -> None:
        position = np.zeros(3) if self.position is None else np.asarray(self.position, dtype=float)
        if position.shape != (3,) or not np.all(np.isfinite(position)):
            raise InputError(f"position of {self.name} is {position}", "allowed: 3 finite numbers, m, world")
        turn = np.eye(3) if self.rotation is None else np.asarray(self.rotation, dtype=float)
        known = turn.shape == (3, 3) and bool(np.all(np.isfinite(turn)))
        if not known or not np.allclose(turn.T @ turn, np.eye(3), rtol=0, atol=UNIT_SLACK):
            raise InputError(f"rotation of {self.name} is {turn.tolist()}", "allowed: (3, 3), orthonormal")
        if np.linalg.det(turn) < 0:
            raise InputError(f"rotation of {self.name} is a reflection", "allowed: determinant 1")

    def acts_at(self, place: NodePlace) -> bool:
        return _waypoint(place, self.phase)

    def targets(self) -> tuple[Target, ...]:
        if self.position is None and self.rotation is None:
            return ()
        target = Target(frame=self.frame, position=self.position, rotation=self.rotation, phase=self.phase)
        return (target,)

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
    """A frame's velocity at the end: ``velocity`` (6,), linear m/s and angular rad/s, world axes.

    ``phase``: where that phase begins, instead of the end of the schedule.
    """

    frame: str
    velocity: np.ndarray
    phase: str | None = None

    def acts_at(self, place: NodePlace) -> bool:
        return _waypoint(place, self.phase)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return Rows.create(context.frame(self.frame).velocity, self.velocity, self.velocity, units.twist)


def _waypoint(place: NodePlace, phase: str | None) -> bool:
    """Whether a node is the first of the phase, or without a phase the last of the schedule."""
    return place.last if phase is None else place.phase.name == phase and place.index == 0


def free_directions(
    robot: Robot,
    q: np.ndarray,
    contacts: Sequence[str],
    normals: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> np.ndarray:
    """Orthonormal basis (nv, n) of the local rates that active contacts leave free at q (nq,).

    The null space of the contact Jacobian over the rates of the local coordinates (world linear and
    body angular velocity of a free-flyer). To ask "at rest" or "there" of these directions only is
    what keeps the rows independent of the contact rows. ``normals`` (3,) are of contacts that slide, by
    name: these are held along them alone.
    """
    if not contacts:
        return np.eye(robot.nv)
    coordinates = Coordinates(robot.model)
    to_pinocchio = np.column_stack(
        [coordinates.node_to_pinocchio(_node_with_rate(coordinates, q, i))[1][0] for i in range(robot.nv)]
    )
    held = []
    for contact in map(robot.contact, contacts):
        rows = contact_jacobian(robot.model, q, [(contact.frame, contact.rows)])
        held.append(normals[contact.name][None] @ rows if contact.name in normals else rows)
    jacobian = np.vstack(held) @ to_pinocchio
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

    def targets(self) -> tuple[Target, ...]:
        return (Target(q=self.q),)

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return free_rows(context, place, self.q, configuration_difference(context, self.q) / units.position)


def free_rows(context: Context, place: NodePlace, q: np.ndarray, quantity: ca.SX) -> Rows:
    """A dimensionless quantity (nv,) vanishes in the directions that active contacts leave free at q."""
    require_configuration(context.robot.model, np.asarray(q, dtype=float), "q")
    surfaces = {name: context.slides_on(context.robot.contact(name)) for name in place.phase.contacts}
    normals = {name: surface.normal for name, surface in surfaces.items() if surface is not None}
    basis = free_directions(context.robot, q, place.phase.contacts, normals)
    return Rows.create(ca.mtimes(context.parameter(basis).T, quantity), 0, 0, 1.0)


def configuration_difference(context: Context, q: np.ndarray) -> ca.SX:
    """Local coordinates (nv,) of the context's configuration relative to q, the turn of it near the guess."""
    coordinates = context.coordinates
    goal = coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))
    goal = goal if context.near is None else coordinates.continued(goal, context.near)
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
        return free_rows(context, place, self.q, context.dxi / units.velocity)


@dataclass(frozen=True, kw_only=True)
class TerminalVelocity(NodeConstraint):
    """The motion ends with velocity ``v`` (nv,) at ``q`` (nq,), in directions that contacts leave free.

    Both are Pinocchio's: of a free-flyer linear and angular velocity in its own axes.
    """

    q: np.ndarray
    v: np.ndarray

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        rates = context.coordinates.node_from_pinocchio(self.q, self.v)[-context.coordinates.nv :]
        return free_rows(context, place, self.q, (context.dxi - context.parameter(rates)) / units.velocity)
