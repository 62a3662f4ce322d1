"""Terms of a whole robot, evaluated on the motion of its reduced robot.

A cost keeps its meaning, its unit and its mean over all joints when it is evaluated on the whole robot's
motion, which follows from the small robot's (see `reduction`). `WholeView` expresses the whole robot in the
small robot's symbols. Holding torques of locked joints are left out.

`TerminalState` requires N^T D^-1 e = 0 for the error e, where N spans the directions that the contacts leave
free. If the goal's contacts differ from the motion's, the meaning of this depends on N. A half therefore
constrains the whole robot's error: with E from the half's rates to the whole's, it combines the rows by the
left singular vectors of A = N^T D^-1 E for the r largest singular values, r being the number of directions
that the half's own contacts leave free (`HalfEnd`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.reduced.scenes.reduction import Reduction, whole_place
from trajopt.reduced.term_reader import on_inputs
from trajopt.robot.mirror import REFLECTION, TWIST
from trajopt.robot.units import Units
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import FrameSymbols, Place
from trajopt.terms.costs import NodeCost
from trajopt.terms.interfaces import Cost, NodeConstraint, NodePlace, PointConstraint, Rows, Term
from trajopt.terms.terminal import TerminalRest, TerminalState, free_directions, guessed_posture

# Number of random points at which rows are compared, and the largest difference of equal rows, scaled units.
SAMPLES = 3
ROUNDING = 1e-9


class WholeView(Context):
    """A context of the whole robot whose symbols are expressions of the small robot's context.

    The base rotation is its current orientation, so its local coordinates are zero. Drive torques are shared
    among images and zero at locked joints. Wrenches and frames of images are mirrored. Parameters and squares
    are those of the small robot's context.
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
        self.time_scale = context.time_scale
        self.rotations, self.xi = self._configuration_of_start()
        matrix = ca.DM(reduction.rates)
        self._rates, self._highest = ca.mtimes(matrix, context._rates), ca.mtimes(matrix, context._highest)
        self._parameters, self._values = context._parameters, context._values
        self._squares = context._squares

    def _configuration_of_start(self) -> tuple[ca.SX, ca.SX]:
        small, reduction = self.small, self.reduction
        node = self.coordinates.node_from_pinocchio(reduction.start, np.zeros(self.robot.nv))
        n4 = 4 * self.coordinates.n_rotations
        xi = ca.SX.zeros(self.robot.nv)
        for row, index in enumerate(self.coordinates.additive_index):
            xi[int(index)] = node[n4 + row]
        for _, (of_whole, followed), sign in reduction.entries():
            xi[of_whole] = sign * small.xi[followed]
        if reduction.is_half:
            half = small.xi[2] / 2
            xi[0], xi[2] = small.xi[0], small.xi[1]
            return ca.vertcat(0, -ca.sin(half), 0, ca.cos(half)), xi
        n = BASE_ROWS[self.robot.base]
        xi[:n] = small.xi[:n]
        return self._rotations_of_start(node[:n4]), xi

    def _rotations_of_start(self, start: np.ndarray) -> ca.SX:
        """Return the rotations of base and spherical joints: the small robot's, or locked at the start."""
        names = [joint.name for joint in self.small.coordinates.joints if joint.rotation is not None]
        parts = []
        for row, joint in enumerate(j for j in self.coordinates.joints if j.rotation is not None):
            if joint.name in names:
                at = names.index(joint.name)
                parts.append(self.small.rotations[4 * at : 4 * at + 4])
            else:
                parts.append(ca.SX(start[4 * row : 4 * row + 4]))
        return ca.vertcat(*parts) if parts else ca.SX(0, 1)

    @property
    @override
    def torque(self) -> ca.SX:
        return ca.mtimes(ca.DM(self.reduction.shares), self.small.torque)

    @property
    @override
    def generalized_forces(self) -> ca.SX:
        forces, small = self.small.generalized_forces, self.reduction.small
        free = ca.DM(self.reduction.rates[:, small.unactuated_rows])
        whole = ca.mtimes(free, forces[small.unactuated_rows.tolist()])
        rows, joints = small.actuated_rows, self.robot.actuated_rows
        shares = self.reduction.shares[: len(joints), : len(rows)]
        whole[joints.tolist()] = ca.mtimes(ca.DM(shares), forces[rows.tolist()])
        return whole

    @cached_property
    @override
    def wrenches(self) -> dict[str, ca.SX]:
        if self.place is Place.NODE:
            return {}
        wrenches = {}
        for contact in self.contacts:
            follower = self.reduction.contacts[contact.name]
            share = self.small.wrenches[follower.name] / self.reduction.contact_members(follower.name)
            wrenches[contact.name] = ca.DM(TWIST[: share.numel()]) * share if follower.mirrored else share
        return wrenches

    @override
    def rate(self, expression: ca.SX) -> ca.SX:
        return self.small.rate(expression)

    @override
    def frame(self, name: str) -> FrameSymbols:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _WholeTerm(Term):
    """A term of the whole robot, under its own name, with the reduction to the small robot."""

    term: Term
    reduction: Reduction

    @property
    @override
    def name(self) -> str:
        return self.term.name


@dataclass(frozen=True, kw_only=True)
class WholeCost(_WholeTerm, Cost):
    """A running cost of the whole robot on the small robot's motion."""

    term: Cost

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return self.term.residual(WholeView(context, self.reduction), self._units(context))

    @override
    def value(self, context: Context, units: Units) -> ca.SX:
        return self.term.value(WholeView(context, self.reduction), self._units(context))

    def _units(self, context: Context) -> Units:
        units = Units(self.reduction.whole)
        return units.impulsive() if context.place is Place.IMPACT else units


@dataclass(frozen=True, kw_only=True)
class WholeImpactCost(WholeCost):
    """A cost on impacts of the whole robot on the small robot's motion."""

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True, eq=False)
class WholePointRows(_WholeTerm, PointConstraint):
    """A point constraint of the whole robot on the small robot's motion, without redundant rows."""

    term: PointConstraint

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        rows = self.term.rows(WholeView(context, self.reduction), Units(self.reduction.whole))
        return None if rows is None else binding_rows(rows, context)


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeCost(_WholeTerm, NodeCost):
    """A node cost of the whole robot on the small robot's motion."""

    term: NodeCost

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        view, units_of_whole = WholeView(context, self.reduction), Units(self.reduction.whole)
        return self.term.quantity(view, units_of_whole, whole_place(place, self.reduction))


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeNodeRows(_WholeTerm, NodeConstraint):
    """A node constraint of the whole robot on the small robot's motion, without redundant rows."""

    term: NodeConstraint

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return self.term.acts_at(place)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        return binding_rows(self._whole_rows(context, place), context)

    def _whole_rows(self, context: Context, place: NodePlace) -> Rows:
        view, units = WholeView(context, self.reduction), Units(self.reduction.whole)
        return self.term.rows(view, units, whole_place(place, self.reduction))


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfEnd(WholeNodeRows):
    """`TerminalState` or `TerminalRest` of the whole robot on the motion of its half."""

    term: TerminalState | TerminalRest

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        if self.term.q is None:
            q = self.reduction.lift_q(guessed_posture(context))
            return replace(self, term=replace(self.term, q=q)).rows(context, units, place)
        reduction, q = self.reduction, np.asarray(self.term.q, dtype=float)
        position = Units(reduction.whole).position
        free = free_directions(reduction.whole, q, whole_place(place, reduction).phase.contacts)
        small = free_directions(reduction.small, reduction.drop_q(q), place.phase.contacts)
        left = np.linalg.svd(free.T @ (reduction.rates / position[:, None]))[0]
        combined = context.parameter(left[:, : small.shape[1]]).T
        return Rows.create(ca.mtimes(combined, self._whole_rows(context, place).expression), 0, 0, 1.0)


def binding_rows(rows: Rows, context: Context) -> Rows:
    """Return the rows without duplicates and without rows that the small robot always satisfies.

    Both are found by comparing values and gradients at random points: the functions are analytic, so rows
    that agree at all points up to rounding agree everywhere.
    """
    scaled = ca.SX(rows.expression) / ca.DM(rows.unit)
    z, (values,) = on_inputs(context, scaled, [context.parameter_values])
    function = ca.Function("rows", [z], [ca.densify(ca.horzcat(values, ca.jacobian(values, z)))])
    generator = np.random.default_rng(0)
    sampled = []
    for _ in range(SAMPLES):  # with unit quaternions and positive time scales
        inputs = generator.uniform(0.1, 1.0, context.z.numel())
        for i in range(context.coordinates.n_rotations):
            inputs[4 * i : 4 * i + 4] /= np.linalg.norm(inputs[4 * i : 4 * i + 4])
        sampled.append(np.array(function(inputs)))
    lower, upper = rows.lower / rows.unit, rows.upper / rows.unit
    chosen: list[int] = []
    for i in range(len(lower)):
        row = np.array([sample[i] for sample in sampled])
        fixed = (
            np.abs(row[:, 1:]).max(initial=0.0) < ROUNDING
            and lower[i] - ROUNDING <= row[0, 0] <= upper[i] + ROUNDING
        )
        repeated = any(
            np.abs(row - [sample[j] for sample in sampled]).max() < ROUNDING
            and (lower[i], upper[i]) == (lower[j], upper[j])
            for j in chosen
        )
        if not (fixed or repeated):
            chosen.append(i)
    return Rows(rows.expression[chosen], rows.lower[chosen], rows.upper[chosen], rows.unit[chosen])
