"""Constraints at touchdown: where a contact lands, and that it does not move."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.robot.contact import Contact
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import without_rolling
from trajopt.terms.interfaces import AtMoment, NodeConstraint, NodePlace, Rows
from trajopt.terrain.patch import Patch
from trajopt.terrain.smooth import CurvedSurface
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Ground, Terrain

# An edge gives a planar robot no row if the part of its normal in the robot's plane is below this.
IN_PLANE_PART = 1e-6


def along_normal(context: Context, surface: Surface, columns: ca.SX) -> ca.SX:
    """Components (1, n) of world-axes columns (3, n) along a surface's normal.

    On level ground this is the third row; elsewhere the normal is a parameter.
    """
    return columns[2, :] if surface.is_level else ca.mtimes(context.parameter(surface.normal).T, columns)


def along_ground(context: Context, ground: Ground, point: ca.SX) -> ca.SX:
    """Height of a point (3,): vertical above smooth ground, else along the normal from the world's origin."""
    if isinstance(ground, CurvedSurface):
        return ground.symbolic_gap(point, context.parameter)
    return along_normal(context, ground, point)


@checked
@dataclass(frozen=True, kw_only=True)
class ContactLanding(AtMoment, NodeConstraint):
    """New contacts of a phase lie on their surface, patch or foothold and do not move.

        p = foothold          or, without one,        n . p = d
        n . R e_x = n . R e_y = 0                     for a sole, which lies flat
        a_i . p_k >= b_i + margin                     on a patch with edges i, for the corners k of a sole
        J v = 0                                       for a sliding contact  n^T J v = 0,
                                                      for a rolling ball     v - w x r n = 0
        d/dt (J v) = 0                                where jerks are the input

    with p the frame's origin, n the normal and d the height of the surface that the phase states for the
    contact, else of the terrain. A contact with a radius touches it with its ball. Over smooth ground the
    second row is the height of p above it. Rows are over l, sqrt(g l) and sqrt(g / l).

    Args:
        at: the start of that phase.
        contacts: names of the new contacts.
        terrain: the ground.
        held: names of contacts that stay active through an impact and do not move after it either.
    """

    contacts: tuple[str, ...]
    terrain: Terrain
    held: tuple[str, ...] = ()

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        parts: list[Rows] = []
        for name in self.contacts:
            parts += _places(context, units, place, context.robot.contact(name), self.terrain)
        if context.actuation != "velocity":
            for name in (*self.contacts, *self.held):
                contact = context.robot.contact(name)
                rows, surface = list(context.held_rows(contact)), context.slides_on(contact)
                velocity, unit = context.contact_velocity(contact)[rows], units.twist[rows]
                if surface is not None:
                    velocity, unit = along_normal(context, surface, velocity), units.twist[0]
                parts.append(Rows.create(velocity, 0.0, 0.0, unit))
                if context.actuation == "jerk":
                    parts.append(_still(context, units, contact, rows, surface))
        lower, upper, unit = (
            np.concatenate([np.zeros(0), *[getattr(part, name) for part in parts]])
            for name in ("lower", "upper", "unit")
        )
        return Rows.create(ca.vertcat(*[part.expression for part in parts]), lower, upper, unit)


def _still(
    context: Context, units: Units, contact: Contact, rows: list[int], surface: Surface | None
) -> Rows:
    """The classical acceleration of a contact vanishes, like its velocity."""
    acceleration, unit = context.frame(contact.frame).acceleration, units.contact_acceleration[rows]
    lever = context.lever(contact)
    if lever is not None:
        acceleration = without_rolling(acceleration, ca.DM(lever))
    held = acceleration[rows]
    if surface is not None:
        held, unit = along_normal(context, surface, held), units.contact_acceleration[0]
    return Rows.create(held, 0.0, 0.0, unit)


def _places(
    context: Context, units: Units, place: NodePlace, contact: Contact, terrain: Terrain
) -> list[Rows]:
    """Where one contact lands: at its foothold, or on its ground and inside its patch; a sole lies flat."""
    frame, held = context.frame(contact.frame), context.held_rows(contact)
    foothold = place.phase.centre(contact, terrain)
    ground = place.phase.surface(contact.name, terrain, contact.radius)
    movable, edges = [row for row in held if row < 3], []
    if foothold is None and contact.name in place.phase.patches:
        edges = _inside(context, units, contact, place.phase.patches[contact.name])
    if foothold is not None:
        rows = [Rows.create(frame.position[movable], foothold[movable], foothold[movable], units.length)]
    elif 2 in held or (movable and not ground.is_level):
        above, height = along_ground(context, ground, frame.position), 0.0
        if isinstance(ground, Surface):
            height = ground.height
        rows = [Rows.create(above, height, height, units.length)]
    else:
        return edges
    tilting = [0 if row == 4 else 1 for row in held if row in (3, 4)]
    if contact.dimension == 6:
        tilting = [0, 1][: sum(row > 2 for row in held)]
    # Axes of a sole that must lie in its surface; for a planar robot, only the one in its plane.
    if tilting and isinstance(ground, Surface):
        rows.append(Rows.create(along_normal(context, ground, frame.rotation[:, tilting]).T, 0.0, 0.0, 1.0))
    return rows + edges


def _inside(context: Context, units: Units, contact: Contact, patch: Patch) -> list[Rows]:
    """Rows of every edge, for the contact's point or corners.

    The distance from the plane has its own row, so these rows use directions in the plane only and are
    independent of it. A robot that moves in a plane of the world has no rows for edges along that plane.
    """
    moves = [row for row in contact.rows if row < 3]
    edges = np.linalg.norm(patch.inward[:, moves], axis=1) > IN_PLANE_PART
    inward, least = context.parameter(patch.inward[edges]), (patch.offsets + patch.margin)[edges]
    points = contact_points(context, contact)
    return [Rows.create(ca.mtimes(inward, point), least, np.inf, units.length) for point in points]


def contact_points(context: Context, contact: Contact) -> list[ca.SX]:
    """The centre (3,) of a point contact, or the four corners of a sole, world, m."""
    frame = context.frame(contact.frame)
    if contact.kind == "point":
        return [frame.position]
    return [frame.position + ca.mtimes(frame.rotation[:, :2], corner) for corner in contact.corners]
