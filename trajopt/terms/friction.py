"""Constraints on contact wrenches: friction, normal force and the cones of soles, each on its own surface."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError
from trajopt.robot.contact import Contact
from trajopt.robot.friction import friction_rows, pressure_rows, yaw_rows
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import PointConstraint, Rows
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.smooth import CurvedSurface
from trajopt.terrain.surface import Surface

# Fraction of the weight below which the apex of a friction cone is smoothed. With a sharper apex IPOPT needs
# several times the iterations where forces start at zero (talos-wall: 16 at 1e-2, 102 at 1e-3).
APEX = 1e-2
# Violation of a row of the cone, as a force over the weight, up to which forces near the apex obey Coulomb's
# law: the solvers' default tolerance. To this end the tip of the cone is cut off, up to a normal force of
# sqrt(TIGHT APEX) / mu, which is 1e-4 / mu of the weight.
TIGHT = 1e-6
# Range w of this tightening exp(-(N / w)^2), with N = mu f_n over the weight.
TIP = APEX / 6


@checked
@dataclass(frozen=True, kw_only=True)
class ContactConstraint(PointConstraint):
    """A constraint on the wrenches of unilateral contacts, and at an impact on their impulses.

    Contacts on bilateral surfaces have no rows, because a grasp holds them. Sliding contacts have none
    because their force follows a law (`trajopt.terms.dynamics`).

    Args:
        friction: coefficient in place of that of the surfaces.
        contacts: names of the contacts; default all.

    Raises:
        InputError: for a coefficient that is negative or not finite.
    """

    acts_at_impacts: ClassVar[bool] = True
    acts_on_forces: ClassVar[bool] = True
    soles_only: ClassVar[bool] = False

    friction: NonNegative | None = None
    contacts: tuple[str, ...] | None = None

    @property
    @override
    def in_check(self) -> bool:
        return self.checked_by_file and self.friction is None

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        if self.contacts is not None and not self.contacts:
            return "contacts is empty"
        for name in self.contacts or ():
            if self.soles_only and robot.contact(name).kind == "point":
                return f"'{name}' is a point contact"
            grounds = [
                schedule.surface(i, name, FlatGround())
                for i, phase in enumerate(schedule.phases)
                if name in phase.contacts and self.acts_in(phase.name)
            ]
            if all(isinstance(g, Surface) and (g.bilateral or g.slip_speed is not None) for g in grounds):
                return f"'{name}' is held or slides wherever it is active"
        return super().idle(robot, schedule)

    @abstractmethod
    def _add_rows(
        self, cone: _ConeRows, contact: Contact, friction: float, context: Context, units: Units
    ) -> None:
        """Add the rows of one contact."""

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        chosen = None if self.contacts is None else [context.contact(name) for name in self.contacts]
        cone = _ConeRows()
        for contact in context.loaded_contacts:
            surface = context.surface(contact)
            if context.slides_on(contact) is not None or surface.bilateral:
                continue
            if (chosen is None or contact in chosen) and (contact.kind == "surface" or not self.soles_only):
                friction = surface.friction if self.friction is None else self.friction
                self._add_rows(cone, contact, friction, context, units)
        if not cone.entries:
            return None
        expressions, upper, unit = zip(*cone.entries, strict=True)
        return Rows.create(ca.vertcat(*expressions), 0, np.array(upper), np.array(unit))


def _turning(contact: Contact) -> tuple[int, ...]:
    """Axes about which a sole transmits a moment; in a planar model, only the one normal to the plane."""
    return (0, 1, 2) if contact.dimension == 6 else tuple(row - 3 for row in contact.rows if row > 2)


def surface_force(context: Context, contact: Contact) -> ca.SX:
    """Force (3,) of an active contact along the two tangents and the normal of its surface, N.

    On level ground these are the world axes. On other planes the axes are parameters, so that one compiled
    function serves any normal. On curved ground they follow from the contact's position.
    """
    surface, force = context.surface(contact), context.wrenches[contact.name][:3]
    if isinstance(surface, CurvedSurface):
        axes = surface.symbolic_frame(context.frame(contact.frame).position, context.parameter)
        return ca.mtimes(axes.T, force)
    return force if surface.is_level else ca.mtimes(context.parameter(surface.frame).T, force)


@dataclass
class _ConeRows:
    """Rows that are >= 0, and rows that are zero, for forces that a frictionless contact cannot transmit.

    Without friction, the sides of a pyramid are pairs of inequalities without an interior, and the smooth
    cone has no gradient. Solvers fail on both, but not on equations.
    """

    entries: list[tuple[ca.SX, float, float]] = field(default_factory=list)  # row, upper bound, unit

    def at_least_zero(self, expressions: Iterable[ca.SX], unit: float) -> None:
        self.entries += [(expression, np.inf, unit) for expression in expressions]

    def zero(self, expressions: Iterable[ca.SX], unit: float) -> None:
        self.entries += [(each, 0.0, unit) for each in expressions if not each.is_zero()]


@checked
@dataclass(frozen=True, kw_only=True)
class FrictionPyramid(ContactConstraint):
    """Unilateral force inside a pyramid inscribed in the Coulomb cone.

        f_n >= 0        |f_1| <= mu f_n / sqrt 2        |f_2| <= mu f_n / sqrt 2

    with f_n along the normal and f_1, f_2 along the tangents of the surface, the world's x and y on level
    ground. Without friction f_1 = f_2 = 0. Rows are over m g.

    Args:
        friction: mu in place of the surfaces' coefficient, dimensionless.
        contacts: names of the contacts; default all.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def _add_rows(
        self, cone: _ConeRows, contact: Contact, friction: float, context: Context, units: Units
    ) -> None:
        f = ca.vertsplit(surface_force(context, contact))
        cone.at_least_zero([f[2]], units.force)
        if friction == 0.0:
            cone.zero(f[:2], units.force)
            return
        sides = friction_rows(f, context.parameter(friction / math.sqrt(2)))
        kept = [side for i, side in enumerate(sides) if not f[i // 2].is_zero()]
        cone.at_least_zero(kept, units.force)


@checked
@dataclass(frozen=True, kw_only=True)
class FrictionCone(ContactConstraint):
    """Unilateral force inside the exact Coulomb cone.

        f_n >= 0        f_1^2 + f_2^2 <= (mu f_n)^2

    The squared form is smooth at the apex, but a solver's tolerance on it is the square of a force, which
    lets small forces slip. The row is therefore, with N = mu f_n and forces over m g,

        (N^2 - f_1^2 - f_2^2) / sqrt(N^2 + d^2) - e exp(-(N / w)^2) >= 0        d = APEX, e = TIGHT, w = TIP

    Away from the apex its feasible set is the cone, and its value is about twice the distance from the cone's
    side. No smooth row describes the whole cone and has a gradient at its apex; this one cuts off the tip,
    which is conservative. A violation v <= e then means that the force exceeds Coulomb's law by at most 2 v:
    with f_t the force along the surface, |f_t|^2 - N^2 <= (v - e exp(-(N / w)^2)) sqrt(N^2 + d^2), which is
    negative near the apex and at most 4 v N elsewhere. Without friction f_1 = f_2 = 0.

    Args:
        friction: mu in place of the surfaces' coefficient, dimensionless.
        contacts: names of the contacts; default all.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def _add_rows(
        self, cone: _ConeRows, contact: Contact, friction: float, context: Context, units: Units
    ) -> None:
        f = ca.vertsplit(surface_force(context, contact) / units.force)
        cone.at_least_zero([f[2]], 1.0)
        if friction == 0.0:
            cone.zero(f[:2], 1.0)
            return
        largest = context.parameter(friction) * f[2]
        inside = largest**2 - f[0] ** 2 - f[1] ** 2
        tight = TIGHT * ca.exp(-((largest / TIP) ** 2))
        cone.at_least_zero([inside / ca.sqrt(largest**2 + APEX**2) - tight], 1.0)


@checked
@dataclass(frozen=True, kw_only=True)
class SoleLimits(ContactConstraint):
    """Centre of pressure of surface contacts inside the sole, and yaw moment within a box.

        |m_x| <= Y f_n        |m_y| <= X f_n        |m_z| <= mu f_n (X + Y) / 2

    with the moment in the sole's axes and its half length X and half width Y in m. The yaw moment is bounded
    whatever the other components are: `SoleCone` is exact. Rows are over m g l.

    Args:
        friction: mu in place of the surfaces' coefficient, dimensionless.
        contacts: names of the contacts; default all.
    """

    checked_by_file: ClassVar[bool] = True
    soles_only: ClassVar[bool] = True

    @override
    def _add_rows(
        self, cone: _ConeRows, contact: Contact, friction: float, context: Context, units: Units
    ) -> None:
        rotation = context.frame(contact.frame).rotation
        moment = ca.mtimes(rotation.T, context.wrenches[contact.name][3:])
        pressure = surface_force(context, contact)[2]
        half = (contact.half_width, contact.half_length)
        arm = (*half, sum(half) / 2 * context.parameter(friction) if friction else 0.0)
        for i in _turning(contact):
            if i == 2 and friction == 0.0:
                cone.zero([moment[i]], units.torque)
                continue
            sides = [arm[i] * pressure - moment[i], arm[i] * pressure + moment[i]]
            cone.at_least_zero(sides, units.torque)


@checked
@dataclass(frozen=True, kw_only=True)
class SoleCone(ContactConstraint):
    """Wrench of each sole inside the exact contact wrench cone, 16 rows.

        |f_x|, |f_y| <= mu f_z        |m_x| <= Y f_z        |m_y| <= X f_z
        mu (X + Y) f_z - |Y f_x - mu m_x| - |X f_y - mu m_y| + m_z >= 0
        mu (X + Y) f_z - |Y f_x + mu m_x| - |X f_y + mu m_y| - m_z >= 0

    in the sole's axes, with its half length X and half width Y in m and mu the coefficient over sqrt 2, so
    that the pyramid along these axes is inscribed in the Coulomb cone (Caron, Pham, Nakamura, ICRA 2015).
    Soles need no other friction term; point contacts have no rows. Rows are over m g and m g l.

    Args:
        friction: in place of the surfaces' coefficient, dimensionless.
        contacts: names of the contacts; default all.
    """

    checked_by_file: ClassVar[bool] = True
    soles_only: ClassVar[bool] = True

    @override
    def _add_rows(
        self, cone: _ConeRows, contact: Contact, friction: float, context: Context, units: Units
    ) -> None:
        to_sole, wrench = context.frame(contact.frame).rotation.T, context.wrenches[contact.name]
        force, moment = (ca.vertsplit(ca.mtimes(to_sole, part)) for part in (wrench[:3], wrench[3:]))
        size = (contact.half_length, contact.half_width)
        if friction == 0.0:
            cone.at_least_zero(pressure_rows(force, moment, size), units.torque)
            cone.zero(force[:2], units.force)
            cone.zero([moment[2]], units.torque)
            return
        mu = context.parameter(friction / math.sqrt(2))
        cone.at_least_zero(friction_rows(force, mu), units.force)
        moments = [*pressure_rows(force, moment, size), *yaw_rows(force, moment, size, mu)]
        cone.at_least_zero(moments, units.torque)


@checked
@dataclass(frozen=True, kw_only=True)
class NormalForce(PointConstraint):
    """Normal force of one contact within bounds, where the contact is active.

        lower <= n . f <= upper

    with n the surface's normal, from it to the robot, and f the force on the robot. The row is over m g.

    Args:
        contact: name of the contact.
        lower: lower bound, N; None for no bound. A positive force pushes the robot away from the surface; a
            negative one, on bilateral surfaces, holds it.
        upper: upper bound, N; None for no bound.

    Raises:
        InputError: without a bound, or for lower > upper.
    """

    acts_on_forces: ClassVar[bool] = True

    contact: str
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        low, high = self._bounds
        if not low <= high or (self.lower is None and self.upper is None):
            raise InputError(
                f"normal force of '{self.contact}' is bounded by {self.lower} and {self.upper}",
                "allowed: at least one bound, lower <= upper",
            )

    @property
    def _bounds(self) -> tuple[float, float]:
        low = -math.inf if self.lower is None else self.lower
        return low, math.inf if self.upper is None else self.upper

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        contact = context.contact(self.contact)
        if contact not in context.loaded_contacts:
            return None
        return Rows.create(surface_force(context, contact)[2], *self._bounds, units.force)


@checked
def contact_cones(contacts: Iterable[Contact]) -> tuple[ContactConstraint, ...]:
    """Friction pyramids if there are point contacts, and wrench cones if there are soles."""
    kinds = {contact.kind for contact in contacts}
    cones: tuple[tuple[str, ContactConstraint], ...] = (("point", FrictionPyramid()), ("surface", SoleCone()))
    return tuple(cone for kind, cone in cones if kind in kinds)
