"""Constraints at chosen moments of a phase: at points, at nodes and between them.

A semi-infinite constraint, which holds at every time, is imposed by rows at the finitely many moments where
it comes near its bound. These moments are exchanged until it also holds in between (Hettich and Kortanek,
"Semi-infinite programming", SIAM Review 35, 1993); `trajopt.solving.exchange` finds them.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.collision.joint_distance import monomials
from trajopt.errors import InputError
from trajopt.pickling import picklable
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows, Term


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class MomentConstraint(Term, ABC):
    """One row at each of n moments of a phase: a smooth function of the motion and of parameters there.

    Args:
        during: name of the phase.
        fractions: the moments (n,) as fractions of the phase's duration, each from 0 to 1.
        parameters: parameters (n, n_p) of the row at each moment.

    Raises:
        InputError: for fractions outside 0 to 1, parameters of another length or not finite.
    """

    during: str
    fractions: np.ndarray
    parameters: np.ndarray

    @property
    def loads(self) -> tuple[str, ...]:
        """Names of the contacts whose wrenches the row depends on."""
        return ()

    def __post_init__(self) -> None:
        fractions = np.array(self.fractions, dtype=float)
        if fractions.ndim != 1 or not np.all((fractions >= 0) & (fractions <= 1)):
            raise InputError(f"fractions of {self.name} are {fractions}", "allowed: (n,), 0 to 1")
        parameters = np.array(self.parameters, dtype=float)
        if parameters.ndim != 2 or len(parameters) != len(fractions) or not np.isfinite(parameters).all():
            raise InputError(
                f"parameters of {self.name} have shape {parameters.shape}",
                f"allowed: ({len(fractions)}, n), finite",
            )
        for label, array in (("fractions", fractions), ("parameters", parameters)):
            array.setflags(write=False)
            object.__setattr__(self, label, array)

    @property
    @override
    def phases(self) -> tuple[str, ...]:
        return (self.during,)

    @abstractmethod
    def row(self, context: Context, units: Units, parameters: ca.SX) -> Rows:
        """The row at one moment, with its ``parameters`` (n_p,) as symbols.

        The context has the wrenches of the contacts in ``loads``, and those only.
        """


def plane_row(frame: str | None, body: str | None) -> str:
    """Name of a row that keeps the bodies of two frames apart by a plane; None for the world."""
    return f"clearance of {frame or 'the world'} and {body or 'the world'}"


def joint_row(joints: Sequence[str]) -> str:
    """Name of a row that keeps apart the two links between which these joints lie."""
    return f"clearance by {', '.join(joints)}"


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneSide(MomentConstraint):
    """A point stays on the positive side of a plane: normal . x >= offset at each moment.

    Point and plane each move with a frame of the robot or are fixed in the world. The parameters of a moment
    are the point (3,) in m in the axes of ``frame``, and the unit normal (3,) and the offset in m in those of
    ``body``. A plane that separates two convex bodies keeps them apart, whatever else they do; see
    `trajopt.collision.planes` for the planes at least distance.

    Args:
        frame: frame that carries the point; None for the world.
        body: frame that carries the plane; None for the world.

    Raises:
        InputError: if both are fixed in the world.
    """

    frame: str | None
    body: str | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame is None and self.body is None:
            raise InputError("point and plane are both fixed in the world", "allowed: one of them")
        if len(self.fractions) and self.parameters.shape[1] != 7:
            raise InputError(
                f"parameters of {self.name} have shape {self.parameters.shape}",
                "allowed: (n, 7), point, normal, offset",
            )

    @property
    @override
    def name(self) -> str:
        return plane_row(self.frame, self.body)

    @override
    def row(self, context: Context, units: Units, parameters: ca.SX) -> Rows:
        point, normal, offset = parameters[:3], parameters[3:6], parameters[6]
        if self.frame is not None:
            carrier = context.frame(self.frame)
            point = carrier.position + ca.mtimes(carrier.rotation, point)
        if self.body is not None:
            carrier = context.frame(self.body)
            normal = ca.mtimes(carrier.rotation, normal)
            offset = offset + ca.dot(normal, carrier.position)
        return Rows.create(ca.dot(normal, point) - offset, 0.0, np.inf, units.length)


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkDistance(MomentConstraint):
    """Two links stay apart: a polynomial in the angles of the joints between them is at least zero.

    The parameters of a moment are the angles (n,) in rad about which the polynomial is expanded, and its
    coefficients (m,) in m; see `trajopt.collision.joint_distance`.

    Args:
        joints: names of the joints between the links, each with one degree of freedom.
    """

    joints: tuple[str, ...]

    @property
    @override
    def name(self) -> str:
        return joint_row(self.joints)

    @override
    def row(self, context: Context, units: Units, parameters: ca.SX) -> Rows:
        model, count = context.robot.model, len(self.joints)
        rows = [model.joints[model.getJointId(name)].idx_v for name in self.joints]
        angles = [context.xi[row] - parameters[k] for k, row in enumerate(rows)]
        coefficients = ca.vertsplit(parameters[count:])
        terms = [
            math.prod(
                (angle for angle, power in zip(angles, powers, strict=True) for _ in range(power)), start=c
            )
            for c, powers in zip(coefficients, monomials(count), strict=True)
        ]
        return Rows.create(ca.sum1(ca.vertcat(*terms)), 0.0, np.inf, units.length)


@dataclass(frozen=True, kw_only=True, eq=False)
class JointSide(MomentConstraint):
    """A joint's position or velocity stays on one side of a bound at each moment.

    The parameters of a moment are the side, 1 for a lower bound and -1 for an upper one, and side times
    bound, in rad, m, rad/s or m/s.

    Args:
        joint: name of a joint with one degree of freedom.
        rate: whether the bound is on its velocity.
    """

    joint: str
    rate: bool = False

    @property
    @override
    def name(self) -> str:
        return "velocity_between" if self.rate else "position_between"

    @override
    def row(self, context: Context, units: Units, parameters: ca.SX) -> Rows:
        model = context.robot.model
        if not model.existJointName(self.joint) or model.joints[model.getJointId(self.joint)].nv != 1:
            raise InputError(f"'{self.joint}' is no joint of one degree of freedom", "allowed: such a joint")
        index = model.joints[model.getJointId(self.joint)].idx_v
        value = (context.dxi if self.rate else context.xi)[index]
        unit = (units.velocity if self.rate else units.position)[index]
        return Rows.create(parameters[0] * value - parameters[1], 0.0, np.inf, unit)


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSide(MomentConstraint):
    """A contact's force stays on the positive side of a plane through the origin at each moment.

    The parameters of a moment are the plane's normal (3,) in world axes. For a friction cone the normal is
    mu n - u, with the surface's normal n and a unit tangent u: this plane touches the cone along one line.

    Args:
        contact: name of an active contact.
    """

    contact: str

    @property
    @override
    def name(self) -> str:
        return "friction_between"

    @property
    @override
    def loads(self) -> tuple[str, ...]:
        return (self.contact,)

    @override
    def row(self, context: Context, units: Units, parameters: ca.SX) -> Rows:
        force = context.wrenches[self.contact][:3]
        return Rows.create(ca.dot(parameters, force), 0.0, np.inf, units.wrench[0])
