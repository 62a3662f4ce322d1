"""Centre of mass and momentum of the whole robot, with what it carries: goals at moments, and costs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import Array3, checked
from trajopt.dynamics import rigid_body
from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.interfaces import AtMoment, Cost, NodeConstraint, NodePlace, Rows

Part = Literal["linear", "angular"]
AXES = "xyz"


@checked
@dataclass(frozen=True, kw_only=True)
class CentreOfMass(AtMoment, NodeConstraint):
    """The centre of mass has a given place at one moment.

        c_i = position_i        for the axes i of the world, over l

    Args:
        position: (3,), m, world.
        axes: those that are given, some of "xyz"; the others are free.
        at: the moment, default the end of the motion.

    Raises:
        InputError: for other axes.
    """

    position: Array3
    axes: str = AXES

    def __post_init__(self) -> None:
        _rows_of(self.name, self.axes)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        rows = _rows_of(self.name, self.axes)
        goal = self.position[rows]
        return Rows.create(_centre(context)[rows], goal, goal, units.length)


@checked
@dataclass(frozen=True, kw_only=True)
class CentreOfMassCost(Cost):
    """Cost on the distance of the centre of mass from a path.

        w |(c - path(t)) / l|^2 / n      over the n given axes of the world

    Args:
        weight: w, dimensionless.
        path: place (3,), m, at nominal time in s from the schedule's start.
        axes: some of "xyz".

    Raises:
        InputError: for other axes.
    """

    path: Callable[[float], np.ndarray]
    axes: str = AXES

    def __post_init__(self) -> None:
        _rows_of(self.name, self.axes)

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        rows = _rows_of(self.name, self.axes)
        return (_centre(context) - context.varying(self.path, 3))[rows] / units.length


@checked
@dataclass(frozen=True, kw_only=True)
class Momentum(AtMoment, NodeConstraint):
    """The linear momentum, or the angular one about the centre of mass, has a given value at one moment.

        h = momentum        over m sqrt(g l), or m l sqrt(g l)

    Args:
        part: "linear" or "angular".
        momentum: (3,), kg m/s or kg m^2/s, world axes; default zero.
        at: the moment, default the end of the motion.
    """

    part: Part
    momentum: Array3 = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        value = np.asarray(self.momentum)
        return Rows.create(_momentum(context, self.part), value, value, _unit(units, self.part))


@checked
@dataclass(frozen=True, kw_only=True)
class MomentumCost(Cost):
    """Cost on the linear momentum, or on the angular one about the centre of mass.

        w |h / u|^2 / 3        with u = m sqrt(g l), or m l sqrt(g l)

    Args:
        weight: w, dimensionless.
        part: "linear" or "angular".
    """

    part: Part

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return _momentum(context, self.part) / _unit(units, self.part)


def _rows_of(term: str, axes: str) -> list[int]:
    """Rows of axes such as "xz". Raises `InputError`."""
    if not axes or set(axes) - set(AXES) or len(set(axes)) < len(axes):
        raise InputError(f"axes of {term} are '{axes}'", "allowed: some of xyz, each once")
    return sorted(AXES.index(axis) for axis in axes)


def _centre(context: Context) -> ca.SX:
    still = ca.SX.zeros(context.coordinates.nv)
    return rigid_body.centre_of_mass(context.robot.model)(context.q, still)[0]


def _momentum(context: Context, part: Part) -> ca.SX:
    whole = rigid_body.centroidal_momentum(context.robot.model)(context.q, context.v)
    return whole[:3] if part == "linear" else whole[3:]


def _unit(units: Units, part: Part) -> float:
    return float((units.force if part == "linear" else units.torque) * units.time)
