"""The dynamics as constraints: balance of the base, contacts that stay in place or slide, and impacts.

A contact on a `Surface` with a ``slip_speed`` v_s may move within the surface. The force f of the surface on
it follows from its normal part f_n >= 0 and its velocity v_t within the surface,

    f = f_n (n - mu v_t / sqrt(|v_t|^2 + v_s^2))

which is Coulomb's law for speeds far above v_s, and smooth where the contact stops or reverses: at v_s the
friction is 1 / sqrt 2 of what it is at high speed (the regularisation of Andersson, Soederberg and
Bjoerklund, Tribology International 40, 2007, without their static peak). A contact without slip speed sticks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms.context import Context
from trajopt.terms.friction import surface_force
from trajopt.terms.interfaces import PointConstraint, Rows
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Ground


@dataclass(frozen=True, kw_only=True)
class BaseDynamics(PointConstraint):
    """The unactuated rows of the dynamics vanish: the base's Newton-Euler equations, and passive joints'.

        [M(q) v' + h(q, v) - sum_c J_c^T f_c]_unactuated = 0

    with the wrenches f_c of the active contacts in world axes. Rows are over m g or m g l. With thrusters
    they are the combinations of rows that no input reaches.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        actuation = context.robot.actuation
        if not len(actuation.balance):
            return None
        scale = actuation.balance_unit(units.generalized_force)
        return Rows.create(context.base_rows, 0, 0, scale)


@dataclass(frozen=True, kw_only=True)
class FollowingJoints(PointConstraint):
    """Mimic joints follow their leaders, see `MimicJoint`.

        xi_j'' - r xi_i'' = 0        for a velocity source:  xi_j' - r xi_i' = 0

    Rows are over g or g / l, and sqrt(g l) or sqrt(g / l). Positions follow too if they do at the start.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        robot, slow = context.robot, context.actuation == "velocity"
        if not robot.mimics:
            return None
        coupling = robot.actuation.coupling
        rows = ca.mtimes(context.parameter(coupling), context.dxi if slow else context.ddxi)
        unit = units.velocity if slow else units.acceleration
        return Rows.create(rows, 0, 0, (np.abs(coupling) * unit).max(axis=1))


@dataclass(frozen=True, kw_only=True)
class ContactAcceleration(PointConstraint):
    """Active contacts do not accelerate.

        J a + J' v = 0           held contacts: linear and, for a sole, angular; 3 or 6 rows
        a - w' x r n = 0         rolling balls of radius r, with a of the centre and w of the link
        n^T (J a + J' v) = 0     sliding contacts: along the normal n of their surface

    Rows are over g or g / l. Axes are the base's for a free-flyer, the world's otherwise.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            acceleration, surface = context.contact_acceleration(contact), context.slides_on(contact)
            if surface is not None:
                parts.append(ca.mtimes(context.parameter(surface.normal).T, acceleration))
                scales.append(units.contact_acceleration[0])
                continue
            parts.append(acceleration)
            scales += units.contact_acceleration[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ContactVelocity(PointConstraint):
    """Active contacts do not move: for velocity sources, in place of `ContactAcceleration`.

        J v = 0        for rolling balls:  v - w x r n = 0

    linear and, for a sole, angular, in world axes. Rows are over sqrt(g l) or sqrt(g / l).
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        parts, scales = [], []
        for contact in context.contacts:
            parts.append(context.contact_velocity(contact)[list(context.held_rows(contact))])
            scales += units.twist[list(context.held_rows(contact))].tolist()
        return Rows.create(ca.vertcat(*parts), 0, 0, np.array(scales)) if parts else None


@dataclass(frozen=True, kw_only=True)
class ImpactDynamics(PointConstraint):
    """A rigid impact: only contact impulses change velocities.

        M(q) (v+ - v-) - sum_c J_c^T Lambda_c = 0

    over all rows, base and joints: joint torques stay finite and have no impulse. Together with J v+ = 0,
    which `ContactLanding` imposes at the node after the impact, the impact is inelastic (Featherstone, "Rigid
    Body Dynamics Algorithms", 2008, sec. 11.7).
    """

    @override
    def rows(self, context: Context, units: Units) -> Rows:
        return Rows.create(context.generalized_forces, 0, 0, units.generalized_force)


def sliding_surfaces(phase: Phase) -> dict[str, Surface]:
    """Surfaces of the contacts that slide in a phase, by the contact's name."""
    return {name: surface for name, surface in phase.surfaces.items() if surface.slip_speed is not None}


def require_sliding(robot: Robot, schedule: Schedule, actuation: str, modes: tuple[str, ...]) -> None:
    """Raise `InputError` for sliding that is not supported; ``modes`` are phases in minimal coordinates."""
    for phase, after in zip(schedule.phases, (*schedule.phases[1:], None), strict=True):
        for name in sliding_surfaces(phase):
            contact, allowed = robot.contact(name), ""
            if contact.kind != "point" or not contact.transmits_all:
                allowed = "point contacts, of robots in space"
            elif actuation != "torque" or phase.name in modes:
                allowed = "actuation 'torque', and no minimal coordinates"
            elif phase.impact:
                allowed = "phases that begin without an impact"
            elif after is not None and name in after.contacts and name not in sliding_surfaces(after):
                allowed = f"that it slides in phase '{after.name}' too, or is not in contact there"
            if allowed:
                raise InputError(f"'{name}' slides in phase '{phase.name}'", f"allowed: {allowed}")


def require_rolling(
    robot: Robot, schedule: Schedule, grounds: Sequence[Mapping[str, Ground]], modes: tuple[str, ...]
) -> None:
    """Raise `InputError` for rolling that is not supported.

    ``grounds`` gives what each phase's contacts touch; ``modes`` are phases in minimal coordinates.
    """
    for phase, touched in zip(schedule.phases, grounds, strict=True):
        for name in phase.contacts:
            ground, allowed = touched.get(name), ""
            if not robot.contact(name).rolling:
                continue
            if ground is None:
                allowed = "dynamics that hold contacts in place"
            elif not isinstance(ground, Surface):
                allowed = "ground of planes, not curved"
            elif ground.bilateral or ground.slip_speed is not None:
                allowed = "surfaces that neither hold it nor let it slide"
            elif phase.name in modes:
                allowed = "phases without minimal coordinates"
            if allowed:
                raise InputError(f"'{name}' rolls in phase '{phase.name}'", f"allowed: {allowed}")


@checked
@dataclass(frozen=True, kw_only=True)
class SlidingFriction(PointConstraint):
    """Friction law of this module at sliding contacts: the force is unilateral and opposes the motion.

        f_t + mu f_n v_t / sqrt(|v_t|^2 + v_s^2) = 0        f_n >= 0

    with f_t and v_t (2,) the force and velocity along the surface's tangents and v_s its slip speed. Rows are
    over m g. Part of the dynamics where a schedule has such contacts, see `Problem.motion_rows`.
    """

    checked_by_file: ClassVar[bool] = True

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        law, normal_forces = [], []
        for contact in context.contacts:
            surface = context.slides_on(contact)
            if surface is None:
                continue
            force = surface_force(context, contact)
            velocity = context.frame(contact.frame).velocity[:3]
            if not surface.is_level:
                velocity = ca.mtimes(context.parameter(surface.frame).T, velocity)
            constants = context.parameter(np.array([surface.friction, float(surface.slip_speed or 0.0)]))
            speed = ca.sqrt(ca.sumsqr(velocity[:2]) + constants[1] ** 2)
            law.append(force[:2] + constants[0] * force[2] * velocity[:2] / speed)
            normal_forces.append(force[2])
        if not law:
            return None
        rows = ca.vertcat(*law, *normal_forces)
        upper = np.concatenate([np.zeros(2 * len(law)), np.full(len(normal_forces), np.inf)])
        return Rows.create(rows, 0.0, upper, units.force)
