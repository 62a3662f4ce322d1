"""The whole robot as a function of the small one's symbols: what terms written for the whole see.

A cost keeps its meaning, its unit and its mean over all joints when it is evaluated on the whole robot's
motion, which follows from the small one's (see `scene_reduction`). Torques that hold locked joints are left
out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np

from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.rerooting import joint_slices
from trajopt.reduced.scenes.reduction import Reduction, whole_place
from trajopt.robot.mirror import REFLECTION, TWIST
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import FrameSymbols, Place
from trajopt.terms.interfaces import Cost, PointConstraint, Rows
from trajopt.terms.node_costs import NodeCost
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.transcription.robot_layers import robot_layers

# Random points at which rows are compared, and what rounding leaves of rows that are equal, natural units.
SAMPLES = 3
SAME = 1e-9


class WholeView(Context):
    """A context of the whole robot whose symbols are expressions in a context of the small one.

    Rotations of the base are its present orientation, so that local coordinates are zero there.
    """

    def __init__(self, context: Context, reduction: Reduction) -> None:
        self.small, self.reduction = context, reduction
        active = {contact.name for contact in context.contacts}
        followed = {name: f.name for name, f in reduction.contacts.items() if f.name in active}
        super().__init__(
            reduction.whole,
            Coordinates(reduction.whole.model),
            tuple(contact for contact in reduction.whole.contacts if contact.name in followed),
            place=context.place,
            actuation=context.actuation,
            surfaces={name: context.surface(reduction.small.contact(f)) for name, f in followed.items()},
        )
        self.clock = context.clock
        self.rotations, self.xi = self._configuration_of_start()
        matrix = ca.DM(reduction.rates)
        self._rates, self._highest = ca.mtimes(matrix, context._rates), ca.mtimes(matrix, context._highest)

    def _configuration_of_start(self) -> tuple[ca.SX, ca.SX]:
        small, reduction = self.small, self.reduction
        node = self.coordinates.node_from_pinocchio(reduction.start, np.zeros(self.robot.nv))
        n4 = 4 * self.coordinates.n_rotations
        xi = ca.SX.zeros(self.robot.nv)
        for row, index in enumerate(self.coordinates.additive_index):
            xi[int(index)] = node[n4 + row]
        for name, follower in reduction.joints.items():
            own = joint_slices(self.robot.model, name)[1]
            xi[own] = follower.sign * small.xi[joint_slices(reduction.small.model, follower.name)[1]]
        if reduction.is_half:
            half = small.xi[2] / 2
            xi[0], xi[2] = small.xi[0], small.xi[1]
            return ca.vertcat(0, -ca.sin(half), 0, ca.cos(half)), xi
        n = BASE_ROWS[self.robot.base]
        xi[:n] = small.xi[:n]
        return self._rotations_of_start(node[:n4]), xi

    def _rotations_of_start(self, start: np.ndarray) -> ca.SX:
        """Rotations of the base and of spherical joints: the small robot's own, or locked at the start."""
        own = [joint.name for joint in self.small.coordinates.joints if joint.rotation is not None]
        parts = []
        for row, joint in enumerate(j for j in self.coordinates.joints if j.rotation is not None):
            if joint.name in own:
                at = own.index(joint.name)
                parts.append(self.small.rotations[4 * at : 4 * at + 4])
            else:
                parts.append(ca.SX(start[4 * row : 4 * row + 4]))
        return ca.vertcat(*parts) if parts else ca.SX(0, 1)

    @property
    def torque(self) -> ca.SX:
        """Torques (nu,) that drives deliver, N m: each image's share; zero at locked joints."""
        return ca.mtimes(ca.DM(self.reduction.shares), self.small.torque)

    @property
    def generalized_forces(self) -> ca.SX:
        """Those that the small robot has, (nv,): the base's within the plane, joints' shares."""
        own, unactuated = self.small.generalized_forces, self.reduction.small.n_unactuated
        base = ca.mtimes(ca.DM(self.reduction.rates[:, :unactuated]), own[:unactuated])
        joints = ca.mtimes(ca.DM(self.reduction.shares), own[unactuated:])
        return ca.vertcat(base[: self.robot.n_unactuated], joints)

    @cached_property
    def wrenches(self) -> dict[str, ca.SX]:
        """Wrench of every active contact of the whole robot: its share, mirrored for an image."""
        if self.place is Place.NODE:
            return {}
        found = {}
        for contact in self.contacts:
            follower = self.reduction.contacts[contact.name]
            share = self.small.wrenches[follower.name] / self.reduction.contact_members(follower.name)
            found[contact.name] = ca.DM(TWIST[: share.numel()]) * share if follower.mirrored else share
        return found

    def frame(self, name: str) -> FrameSymbols:
        """Symbols of a frame of the small robot, mirrored if it is on a limb that is an image."""
        frame = self.small.frame(name)
        if name not in self.reduction.mirrored_frames:
            return frame
        mirror, twist = ca.DM(REFLECTION), ca.DM(TWIST)
        return FrameSymbols(
            ca.mtimes(ca.mtimes(ca.diag(mirror), frame.rotation), ca.diag(mirror)),
            mirror * frame.position + ca.DM([0.0, 2 * self.reduction.y0, 0.0]),
            twist * frame.velocity,
            twist * frame.acceleration,
        )

    def parameter(self, value: np.ndarray | float) -> ca.SX:
        """A parameter of the small robot's context."""
        return self.small.parameter(value)

    def square(self, residual: ca.SX, weight: ca.SX) -> None:
        """Tell Gauss-Newton of a cost in the small robot's context."""
        self.small.square(residual, weight)

    def varying(self, value: Callable[[float], np.ndarray], size: int) -> ca.SX:
        """A parameter of the small robot's context that varies in time."""
        return self.small.varying(value, size)


@dataclass(frozen=True, kw_only=True)
class WholeCost(Cost):
    """A running cost of the whole robot, on the motion of the small one."""

    term: Cost
    reduction: Reduction

    @property
    def name(self) -> str:
        return self.term.name

    def residual(self, context: Context, units: Units) -> ca.SX:
        return self.term.residual(WholeView(context, self.reduction), self._units(context))

    def value(self, context: Context, units: Units) -> ca.SX:
        return self.term.value(WholeView(context, self.reduction), self._units(context))

    def _units(self, context: Context) -> Units:
        units = Units(self.reduction.whole)
        return units.impulsive() if context.place is Place.IMPACT else units


@dataclass(frozen=True, kw_only=True)
class WholeImpactCost(WholeCost):
    """The same of a cost of impacts."""

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True


def whole_cost(term: Cost, reduction: Reduction) -> Cost:
    """Return the cost as the small robot's problem has it."""
    kind = WholeCost if term.acts_at_points else WholeImpactCost
    return kind(weight=term.weight, phases=term.phases, term=term, reduction=reduction)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeCost(NodeCost):
    """A cost at nodes of the whole robot, on the motion of the small one."""

    term: NodeCost
    reduction: Reduction

    @property
    def name(self) -> str:
        return self.term.name

    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)

    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        view, own = WholeView(context, self.reduction), Units(self.reduction.whole)
        return self.term.quantity(view, own, whole_place(place, self.reduction))


@dataclass(frozen=True, kw_only=True, eq=False)
class WholePointRows(PointConstraint):
    """A point constraint of the whole robot on the small one's motion, without rows that bind nothing."""

    term: PointConstraint
    reduction: Reduction

    @property
    def name(self) -> str:
        return self.term.name

    def rows(self, context: Context, units: Units) -> Rows | None:
        found = self.term.rows(WholeView(context, self.reduction), Units(self.reduction.whole))
        return None if found is None else distinct(found, context)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeTerm(NodeConstraint):
    """A node constraint of the whole robot on the motion of the small one: its name, and where it acts."""

    term: NodeConstraint
    reduction: Reduction

    @property
    def name(self) -> str:
        return self.term.name

    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeRows(WholeNodeTerm):
    """Its rows, without those that bind nothing."""

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        view, own = WholeView(context, self.reduction), Units(self.reduction.whole)
        found = self.term.rows(view, own, whole_place(place, self.reduction))
        return distinct(found, context)


def distinct(rows: Rows, context: Context) -> Rows:
    """Return the rows without those that the small robot meets whatever it does, and without repetitions.

    Found by values and gradients at random points: what is the same at all of them, up to rounding, is the
    same everywhere, since the functions are analytic.
    """
    function = _values_and_gradients(ca.SX(rows.expression) / ca.DM(rows.unit), context)
    generator = np.random.default_rng(0)
    sampled = [np.array(function(_random_inputs(context, generator))) for _ in range(SAMPLES)]
    lower, upper = rows.lower / rows.unit, rows.upper / rows.unit
    chosen: list[int] = []
    for i in range(len(lower)):
        own = np.array([sample[i] for sample in sampled])
        fixed = np.abs(own[:, 1:]).max(initial=0.0) < SAME and lower[i] - SAME <= own[0, 0] <= upper[i] + SAME
        repeated = any(
            np.abs(own - [sample[j] for sample in sampled]).max() < SAME
            and (lower[i], upper[i]) == (lower[j], upper[j])
            for j in chosen
        )
        if not (fixed or repeated):
            chosen.append(i)
    return Rows(rows.expression[chosen], rows.lower[chosen], rows.upper[chosen], rows.unit[chosen])


def _values_and_gradients(expression: ca.SX, context: Context) -> ca.Function:
    """z -> (n, 1 + n_z) values and gradients of rows at the parameters' present values."""
    o, layers = robot_layers(context, expression)
    terms = ca.Function("terms", [context.z, o, context.parameters], [expression])
    z = value = ca.SX.sym("z", context.z.numel())
    for layer in layers:
        value = layer(value)
    found = terms(z, value if layers else ca.SX(0, 1), ca.DM(context.parameter_values))
    return ca.Function("rows", [z], [ca.densify(ca.horzcat(found, ca.jacobian(found, z)))])


def _random_inputs(context: Context, generator: np.random.Generator) -> np.ndarray:
    """Inputs of a point with unit rotations and positive clocks."""
    z = generator.uniform(0.1, 1.0, context.z.numel())
    for i in range(context.coordinates.n_rotations):
        z[4 * i : 4 * i + 4] /= np.linalg.norm(z[4 * i : 4 * i + 4])
    return z
