"""Periodic motions: the final state is the image of the initial one, which is free.

The image is a translation, a turn about the vertical, or a reflection in the vertical plane of the initial
heading (half a cycle of a symmetric gait). With the state in the coordinates of a node (quaternion, additive
positions, rates: world linear, body angular velocity) each of these is linear:

    p' = Rz p + t          pdot' = Rz pdot         omega' = omega         q' = q_z q          (turn)
    x' = s_i x_(i)         (y and its like change sign; left and right joints swap)

For unit quaternions the vector parts relative to the start's reference suffice. So all rows are linear,
except one for every rotation: its norm at the start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.robot.mirror import TWIST, find_mirror, mirrored_rows, paired_contacts
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import AtMoment, NodeConstraint, NodePlace, Rows

if TYPE_CHECKING:
    from trajopt.schedule.schedule import Schedule

# Contacts count as mirror images of each other within this fraction of the robot's length: the sides of real
# robots have small offsets, and a half cycle only needs to match the feet.
PAIR_DISTANCE = 5e-2


@checked
@dataclass(frozen=True, kw_only=True)
class Periodicity:
    """The final state equals the initial one up to a translation, a turn and a reflection.

    Args:
        translation: translation (3,) of the base over the whole schedule, m, world.
        velocity: mean velocity (3,), m/s, instead of a translation; the duration may then be free.
        turn: turn to the left about the vertical through the start's base, rad.
        mirror: whether the final state is the mirror image of the initial one in the vertical plane through
            the start's base along x; needs a free-flyer whose left and right sides correspond.

    Raises:
        InputError: for both a translation and a velocity, a turn with a mirror, or numbers that are not
            finite.
    """

    translation: tuple[float, float, float] | None = None
    velocity: tuple[float, float, float] | None = None
    turn: float = 0.0
    mirror: bool = False

    def __post_init__(self) -> None:
        if self.translation is not None and self.velocity is not None:
            raise InputError("a periodicity has both a translation and a velocity", "allowed: one of them")
        if self.mirror and self.turn:
            raise InputError("a mirrored periodicity turns", "allowed: turn=0 with mirror=True")

    def moved(self, duration: float) -> np.ndarray:
        """Translation (3,) in m over that duration in s."""
        if self.velocity is not None:
            return np.array(self.velocity) * duration
        return np.zeros(3) if self.translation is None else np.array(self.translation)

    def images(self, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """Index and sign (nv,) of the rate from which each rate of the image comes."""
        if self.mirror:
            return mirrored_rows(robot, find_mirror(robot))
        return np.arange(robot.nv), np.ones(robot.nv)


@dataclass(frozen=True, kw_only=True)
class UnitRotation(AtMoment, NodeConstraint):
    """The quaternions of a free start have unit norm; those of later nodes inherit it."""

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        count = context.coordinates.n_rotations
        norms = [ca.sumsqr(context.rotations[4 * i : 4 * i + 4]) for i in range(count)]
        return Rows.create(ca.vertcat(*norms), 1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class ClosingMap:
    """``left z_N = right z_0 + constant``: rows over the rotations, additive positions and rates of a node.

    ``left``, ``right`` (n, n_node) and ``constant`` (n,) are those at zero translation. ``translated`` (n, 3)
    maps a translation to its contribution to the constant.
    """

    left: np.ndarray
    right: np.ndarray
    constant: np.ndarray
    translated: np.ndarray


def closing_map(robot: Robot, periodicity: Periodicity, initial_q: np.ndarray, order: int = 2) -> ClosingMap:
    """The linear rows of a periodicity, in the coordinates of a node (see ``manifold.Coordinates``).

    Nodes of ``order`` 3 have accelerations, whose map is that of the rates.

    Raises `InputError` for a base that cannot turn or be mirrored in this way.
    """
    coordinates = Coordinates(robot.model)
    _require_base(robot, coordinates.n_rotations, periodicity)
    index, sign = periodicity.images(robot)
    rates = sign[:, None] * np.eye(robot.nv)[index]
    turned = pin.utils.rotate("z", periodicity.turn)
    if robot.base == "freeflyer":
        rates[:3, :3] = turned @ rates[:3, :3]
    additive = coordinates.additive_index
    positions = rates[np.ix_(additive, additive)]
    origin = coordinates.node_from_pinocchio(initial_q, np.zeros(robot.nv))
    n4 = 4 * coordinates.n_rotations
    fixed = np.zeros(len(additive))
    moved = np.zeros((len(additive), 3))  # change of the additive positions per translation
    if robot.base == "planar":
        moved[[0, 1], [0, 2]] = 1.0
    elif robot.base != "fixed":
        moved[:3] = np.eye(3)
    if robot.base == "freeflyer":
        fixed[:3] = (np.eye(3) - positions[:3, :3]) @ origin[n4 : n4 + 3]
    left_rotation, right_rotation = _rotation_rows(origin[:n4], periodicity)
    derivatives = order - 1
    left = _block(left_rotation, np.eye(len(additive)), *[np.eye(robot.nv)] * derivatives)
    right = _block(right_rotation, positions, *[rates] * derivatives)
    before, after = np.zeros((len(left_rotation), 3)), np.zeros((derivatives * robot.nv, 3))
    return ClosingMap(
        left=left,
        right=right,
        constant=np.concatenate([before[:, 0], fixed, after[:, 0]]),
        translated=np.vstack([before, moved, after]),
    )


def _require_base(robot: Robot, rotations: int, periodicity: Periodicity) -> None:
    if rotations > (robot.base == "freeflyer"):
        raise InputError(f"robot '{robot.name}' has a spherical joint", "allowed in a periodic motion: none")
    if (periodicity.turn or periodicity.mirror) and robot.base != "freeflyer":
        raise InputError(
            f"robot '{robot.name}' has a {robot.base} base", "allowed with turn or mirror: a free-flyer"
        )


def _rotation_rows(origin: np.ndarray, periodicity: Periodicity) -> tuple[np.ndarray, np.ndarray]:
    """Rows (3, 4) on the final and the initial quaternion: vector parts relative to the start's."""
    if not len(origin):
        return np.zeros((0, 0)), np.zeros((0, 0))
    half = periodicity.turn / 2
    turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
    image = origin * np.array([-1.0, 1.0, -1.0, 1.0]) if periodicity.mirror else origin
    conjugate = np.array([-1.0, -1.0, -1.0, 1.0])
    final = _left_product(conjugate * (_left_product(turn) @ image))[:3]
    initial = _left_product(conjugate * origin)[:3]
    return final, TWIST[3:, None] * initial if periodicity.mirror else initial


def _left_product(quaternion: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) of q -> quaternion q, both (x, y, z, w)."""
    x, y, z, w = quaternion
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])


def _block(*parts: np.ndarray) -> np.ndarray:
    """Block-diagonal matrix; parts may be empty."""
    block = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    row = column = 0
    for part in parts:
        block[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return block


def landing_at_start(robot: Robot, schedule: Schedule, periodicity: Periodicity) -> tuple[str, ...]:
    """Contacts that land at the start, because their image is not in contact at the end.

    Contacts that hold across the end have landed within the cycle.

    Raises:
        InputError: for a contact that never lands, whose position would follow from no row or from two.
    """
    images = {contact.name: contact.name for contact in robot.contacts}
    if periodicity.mirror:
        pairs = paired_contacts(robot, find_mirror(robot), PAIR_DISTANCE)
        images = {c.name: robot.contacts[pairs[i]].name for i, c in enumerate(robot.contacts)}
    first, last = schedule.phases[0], schedule.phases[-1]
    for name in first.contacts:
        if all({name, images[name]} <= set(phase.contacts) for phase in schedule.phases):
            raise InputError(
                f"'{name}' is in contact all the time of a periodic motion",
                "allowed: contacts that land within the cycle, or no periodicity",
            )
    return tuple(name for name in first.contacts if images[name] not in last.contacts)
