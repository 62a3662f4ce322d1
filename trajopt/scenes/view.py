"""The whole robot as a function of the small one's symbols: the context of terms written for the whole.

A cost keeps its meaning, its unit and its mean over all joints when it is evaluated on the whole robot's
motion, which follows from the small one's (see `reduction`). Torques that hold locked joints are left
out.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.mirror import REFLECTION, TWIST
from trajopt.scenes.reduction import Reduction
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import FrameSymbols, Place


class WholeView(Context):
    """A context of the whole robot whose symbols are expressions in a context of the small one.

    Rotations of the base are its present orientation, so that local coordinates are zero there. Torques of
    drives are each image's share, zero at locked joints; wrenches and frames of images are mirrored.
    Parameters and squares are those of the small robot's context.
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
        for _, (own, followed), sign in reduction.entries():
            xi[own] = sign * small.xi[followed]
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
    @override
    def torque(self) -> ca.SX:
        return ca.mtimes(ca.DM(self.reduction.shares), self.small.torque)

    @property
    @override
    def generalized_forces(self) -> ca.SX:
        own, unactuated = self.small.generalized_forces, self.reduction.small.n_unactuated
        base = ca.mtimes(ca.DM(self.reduction.rates[:, :unactuated]), own[:unactuated])
        joints = ca.mtimes(ca.DM(self.reduction.shares), own[unactuated:])
        return ca.vertcat(base[: self.robot.n_unactuated], joints)

    @cached_property
    @override
    def wrenches(self) -> dict[str, ca.SX]:
        if self.place is Place.NODE:
            return {}
        found = {}
        for contact in self.contacts:
            follower = self.reduction.contacts[contact.name]
            share = self.small.wrenches[follower.name] / self.reduction.contact_members(follower.name)
            found[contact.name] = ca.DM(TWIST[: share.numel()]) * share if follower.mirrored else share
        return found

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
