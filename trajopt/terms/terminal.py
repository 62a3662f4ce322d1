"""Constraints at the end of a motion, in the directions that active contacts leave free."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.dynamics.rotations import rotation_error, rotation_matrix
from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import wheel_rows
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.robot.validation import require_configuration
from trajopt.schedule.moment import Target
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import NodeConstraint, NodePlace, Rows

# Singular values of a contact Jacobian below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-6


@checked
def free_directions(
    robot: Robot,
    q: np.ndarray,
    contacts: Sequence[str],
    normals: Mapping[str, np.ndarray] = MappingProxyType({}),
    levers: Mapping[str, np.ndarray | None] = MappingProxyType({}),
) -> np.ndarray:
    """Orthonormal basis (nv, n) of the local rates that active contacts leave free.

    The null space of the contact Jacobian over the rates of the local coordinates (world linear and body
    angular velocity of a free-flyer). Goals that constrain only these directions have rows that are
    independent of the contact rows.

    Args:
        robot: the robot.
        q: configuration (nq,).
        contacts: names of the active contacts.
        normals: unit normals (3,) of the surfaces of sliding contacts, by the contact's name; these contacts
            are held along the normal alone.
        levers: levers (3,) of rolling contacts, m, by the contact's name, else None; see `Contact.lever`.
    """
    if not contacts:
        return robot.actuation.independent if robot.mimics else np.eye(robot.nv)
    coordinates = Coordinates(robot.model)
    nodes = np.tile(coordinates.node_from_pinocchio(q, np.zeros(robot.nv)), (robot.nv, 1))
    nodes[:, -robot.nv :] = np.eye(robot.nv)
    to_pinocchio = coordinates.node_to_pinocchio(nodes)[1].T
    held = []
    for contact in map(robot.contact, contacts):
        rows = contact_jacobian(robot.model, q, [(contact.frame, contact.rows)], [levers.get(contact.name)])
        held.append(normals[contact.name][None] @ rows if contact.name in normals else rows)
    held.append(robot.actuation.coupling)
    jacobian = np.vstack(held) @ to_pinocchio
    _, singular, vt = np.linalg.svd(jacobian)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return vt[rank:].T


@checked
@dataclass(frozen=True, kw_only=True)
class TerminalState(NodeConstraint):
    """The motion ends in a configuration, in the directions that active contacts leave free.

        N^T ((xi - xi*) / u) = 0

    with N (nv, n) the `free_directions` at q and u the unit of each coordinate, l or 1 rad. For a rotation,
    the difference is 2 tan(angle / 2) times its axis. The angles of rolling wheels are left free.

    Args:
        q: configuration (nq,), m and rad.
    """

    q: np.ndarray

    @override
    def targets(self) -> tuple[Target, ...]:
        return (Target(q=self.q),)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        robot, difference = context.robot, configuration_difference(context, self.q) / units.position
        rolling = [name for name in place.phase.contacts if context.lever(robot.contact(name)) is not None]
        wheels = [row for name, row in wheel_rows(robot).items() if name in rolling]
        return free_rows(context, place, self.q, difference, wheels)


def free_rows(
    context: Context, place: NodePlace, q: np.ndarray, quantity: ca.SX, wheels: Sequence[int] = ()
) -> Rows:
    """Rows on which a quantity (nv,), over its unit, vanishes in the directions that contacts leave free.

    Its rows ``wheels`` are left free.
    """
    require_configuration(context.robot.model, np.asarray(q, dtype=float), "q")
    surfaces = {name: context.slides_on(context.robot.contact(name)) for name in place.phase.contacts}
    normals = {name: surface.normal for name, surface in surfaces.items() if surface is not None}
    levers = {name: context.lever(context.robot.contact(name)) for name in place.phase.contacts}
    basis = free_directions(context.robot, q, place.phase.contacts, normals, levers)
    if wheels:
        basis[list(wheels)] = 0.0
        vectors, singular, _ = np.linalg.svd(basis, full_matrices=False)
        basis = vectors[:, singular > RANK_TOLERANCE]
    return Rows.create(ca.mtimes(context.parameter(basis).T, quantity), 0, 0, 1.0)


def configuration_difference(context: Context, q: np.ndarray) -> ca.SX:
    """Local coordinates (nv,) relative to the configuration q, at the whole turn nearest the guess."""
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


@checked
@dataclass(frozen=True, kw_only=True)
class TerminalRest(NodeConstraint):
    """The motion ends at rest, in the directions that active contacts leave free.

        N^T (xi' / u) = 0

    with N (nv, n) the `free_directions` at q and u the unit of each rate, sqrt(g l) or sqrt(g / l).

    Args:
        q: configuration (nq,) at which these directions are taken; default that of the guess.

    Where jerks are the input, accelerations vanish as well, N^T (xi'' / u) = 0.
    """

    q: np.ndarray | None = None

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        q = guessed_posture(context) if self.q is None else self.q
        rates = free_rows(context, place, q, context.dxi / units.velocity)
        if context.actuation != "jerk":
            return rates
        second = free_rows(context, place, q, context.ddxi / units.acceleration)
        return Rows.create(ca.vertcat(rates.expression, second.expression), 0, 0, 1.0)


def guessed_posture(context: Context) -> np.ndarray:
    """Configuration (nq,) of the guess at a node, or the reference if there is no guess."""
    return context.robot.reference if context.guess is None else context.guess()


@checked
@dataclass(frozen=True, kw_only=True)
class TerminalVelocity(NodeConstraint):
    """The motion ends with a given velocity in the directions that active contacts leave free.

        N^T ((xi' - xi'*) / u) = 0

    with N (nv, n) the `free_directions` at q and u the unit of each rate, sqrt(g l) or sqrt(g / l).

    Args:
        q: configuration at the end (nq,), m and rad.
        v: Pinocchio's velocity (nv,), m/s and rad/s; that of a free-flyer is in its own axes.
    """

    q: np.ndarray
    v: np.ndarray

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        rates = context.coordinates.node_from_pinocchio(self.q, self.v)[-context.coordinates.nv :]
        return free_rows(context, place, self.q, (context.dxi - context.parameter(rates)) / units.velocity)


@checked
@dataclass(frozen=True, kw_only=True)
class TerminalLinear(NodeConstraint):
    """The motion ends on a line, plane or subspace of joint positions and rates.

        P xi + V xi' = c

    Rows are over their largest entry in the units of positions and rates.

    Args:
        position: P (n, nv), of joints with one coordinate, 1/m or 1/rad.
        velocity: V (n, nv), s/m or s/rad.
        value: c (n,).

    Raises:
        InputError: for other shapes, a row of zeros, and positions of joints that are 3D rotations.
    """

    position: np.ndarray
    velocity: np.ndarray
    value: np.ndarray

    def __post_init__(self) -> None:
        rows = len(self.value)
        if (
            self.position.ndim != 2
            or self.position.shape != self.velocity.shape
            or len(self.position) != rows
        ):
            raise InputError(
                f"{self.name} has shapes {self.position.shape} and {self.velocity.shape}, and {rows} values",
                "allowed: (n, nv) twice, and n values",
            )
        if not (np.abs(self.position) + np.abs(self.velocity)).any(axis=1).all():
            raise InputError(f"a row of {self.name} is zero", "allowed: rows with a position or a velocity")

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        nv = context.coordinates.nv
        if self.position.shape[1] != nv:
            raise InputError(
                f"{self.name} has {self.position.shape[1]} columns", f"allowed: {nv}, those of v"
            )
        others = np.setdiff1d(np.arange(nv), context.coordinates.additive_index)
        if self.position[:, others].any():
            raise InputError(f"{self.name} has positions of a rotation", "allowed: joints of one coordinate")
        sizes = np.hstack([np.abs(self.position) * units.position, np.abs(self.velocity) * units.velocity])
        given = (context.parameter(part) for part in (self.position, self.velocity, self.value))
        position, velocity, value = given
        quantity = ca.mtimes(position, context.xi) + ca.mtimes(velocity, context.dxi) - value
        return Rows.create(quantity, 0, 0, sizes.max(axis=1))


# Rows of v that are the base's translation along the world's x and y, by kind of base; -1 if it has none.
HORIZONTAL = {"planar": (0, -1), "freeflyer": (0, 1)}


@checked
@dataclass(frozen=True, kw_only=True)
class TerminalPosture(NodeConstraint):
    """The motion ends in a given posture, shifted horizontally to wherever a contact has landed.

        N^T ((xi - xi* - B (p - p*)) / u) = 0

    as for `TerminalState`, with p the contact's position, p* its position in q, and B the map of the
    horizontal part to the base's rows. The base is a free-flyer or planar, in the world's axes.

    Args:
        q: configuration (nq,); it is displaced horizontally to where the contact stands.
        over: name of the contact.

    Raises:
        InputError: for another kind of base.
    """

    q: np.ndarray
    over: str

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        last = schedule.phases[-1]
        return "" if self.over in last.contacts else f"'{self.over}' is not active in phase '{last.name}'"

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        robot, q, foot = context.robot, context.posture(self.q), context.contact(self.over)
        if robot.base not in HORIZONTAL:
            what = f"robot '{robot.name}' has a {robot.base} base"
            raise InputError(what, "allowed: freeflyer or planar for a free place")
        goal = contact_positions(robot, q)[self.over]
        error = configuration_difference(context, q)
        for axis, row in enumerate(HORIZONTAL[robot.base]):
            if row >= 0:
                error[row] -= context.frame(foot.frame).position[axis] - context.parameter(goal[axis])
        return free_rows(context, place, q, error / units.position)
