"""What a term sees at one point: symbols of the state, and of the robot's functions of it.

Terms are written in two layers. The robot's functions (generalised forces, contact placements,
velocities, accelerations) are *symbols* here; their graph is joined, and differentiated, once for
all terms in ``stage_functions``. So a term stays a small expression.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from trajopt.errors import InputError
from trajopt.manifold import Coordinates
from trajopt.robot import Contact, Robot


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of one frame, world axes: placement (m), velocity and classical acceleration.

    The last two have 6 entries: linear, angular.
    """

    rotation: ca.SX  # (3, 3)
    position: ca.SX  # (3,)
    velocity: ca.SX  # (6,)
    acceleration: ca.SX  # (6,)

    @classmethod
    def create(cls, frame: str) -> FrameSymbols:
        """Fresh symbols for ``frame``."""
        return cls(
            ca.SX.sym(f"R_{frame}", 3, 3),
            ca.SX.sym(f"p_{frame}", 3),
            ca.SX.sym(f"v_{frame}", 6),
            ca.SX.sym(f"a_{frame}", 6),
        )

    def stacked(self) -> ca.SX:
        """All entries in one column (24,), columns of the rotation first."""
        return ca.vertcat(ca.vec(self.rotation), self.position, self.velocity, self.acceleration)


class Context:
    """Symbols of one point or node.

    At a collocation point the inputs ``z`` are (rotations, xi, xi', xi'', wrenches); at a node they
    are its state. ``xi``, ``dxi``, ``ddxi`` (nv) are local coordinates (see ``manifold``), ``q``, ``v``,
    ``a`` Pinocchio's; wrenches act on the robot, world axes at the contact frame's origin, N and N m.
    """

    def __init__(
        self, robot: Robot, coordinates: Coordinates, contacts: tuple[Contact, ...], *, node: bool
    ) -> None:
        self.robot, self.coordinates, self.contacts = robot, coordinates, contacts
        nv = coordinates.nv
        if node:
            self.z = ca.SX.sym("x", coordinates.n_node)
            self.rotations, self.xi, self.dxi = coordinates.split_node(self.z)
            self.ddxi = ca.SX.zeros(nv)
            self.wrenches: dict[str, ca.SX] = {}
        else:
            self.rotations = ca.SX.sym("r", 4 * coordinates.n_rotations)
            self.xi, self.dxi, self.ddxi = (ca.SX.sym(name, nv) for name in ("xi", "dxi", "ddxi"))
            self.wrenches = {
                contact.name: ca.SX.sym(f"w_{contact.name}", contact.dimension) for contact in contacts
            }
            self.z = ca.vertcat(self.rotations, self.xi, self.dxi, self.ddxi, *self.wrenches.values())
        self._generalized_forces: ca.SX | None = None
        self._accelerations: dict[Contact, ca.SX] = {}
        self._frames: dict[str, FrameSymbols] = {}
        self._parameters: list[ca.SX] = []
        self._values: list[np.ndarray] = []

    @cached_property
    def _configuration(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        return self.coordinates.to_pinocchio(self.rotations, self.xi, self.dxi, self.ddxi)

    @property
    def q(self) -> ca.SX:
        """Pinocchio's configuration (nq,); built on first use."""
        return self._configuration[0]

    @property
    def v(self) -> ca.SX:
        """Pinocchio's velocity (nv,)."""
        return self._configuration[1]

    @property
    def a(self) -> ca.SX:
        """Pinocchio's acceleration (nv,)."""
        return self._configuration[2]

    @property
    def generalized_forces(self) -> ca.SX:
        """RNEA(q, v, a) minus the contacts' J^T w, (nv,): base rows first, then joint torques."""
        if self._generalized_forces is None:
            self._generalized_forces = ca.SX.sym("tau", self.coordinates.nv)
        return self._generalized_forces

    @property
    def base_rows(self) -> ca.SX:
        """Unactuated rows of the generalised forces; dynamics holds where they vanish."""
        return self.generalized_forces[: self.robot.n_unactuated]

    @property
    def torque(self) -> ca.SX:
        """Joint torques (nu,) in N m."""
        return self.generalized_forces[self.robot.n_unactuated :]

    def frame(self, name: str) -> FrameSymbols:
        """Symbols of the frame ``name`` of the model."""
        if name not in self._frames:
            self._frames[name] = FrameSymbols.create(name)
        return self._frames[name]

    def parameter(self, value: np.ndarray | float) -> ca.SX:
        """A symbol whose numeric ``value`` may change without building or compiling anything anew."""
        array = np.atleast_1d(np.asarray(value, dtype=float))
        if not np.all(np.isfinite(array)):
            raise InputError(f"a term's parameter is {array}", "allowed: finite numbers")
        symbol = ca.SX.sym(
            f"p{len(self._parameters)}", *(array.shape if array.ndim == 2 else (array.size, 1))
        )
        self._parameters.append(ca.vec(symbol))
        self._values.append(array.flatten(order="F"))
        return symbol

    @property
    def parameters(self) -> ca.SX:
        """All parameters in one column."""
        return ca.vertcat(*self._parameters) if self._parameters else ca.SX(0, 1)

    @property
    def parameter_values(self) -> np.ndarray:
        """Their numeric values."""
        return np.concatenate(self._values) if self._values else np.zeros(0)

    def contact_acceleration(self, contact: Contact) -> ca.SX:
        """Classical acceleration of an active contact (3 or 6: linear, angular), in axes that may be turned.

        The axes are the base link's for a free-flyer, the world's otherwise: enough for a row that
        asks it to vanish, and cheaper, since no orientation enters.
        """
        if contact not in self._accelerations:
            self._accelerations[contact] = ca.SX.sym(f"a_{contact.name}", contact.dimension)
        return self._accelerations[contact]

    @property
    def uses_dynamics(self) -> bool:
        """Whether a term asked for generalised forces."""
        return self._generalized_forces is not None

    @property
    def used_accelerations(self) -> tuple[Contact, ...]:
        """Contacts whose acceleration a term asked for."""
        return tuple(self._accelerations)

    @property
    def frames(self) -> Mapping[str, FrameSymbols]:
        """Frames that terms asked for, in order of first use."""
        return self._frames

    def dynamics_symbols(self) -> ca.SX:
        """Generalised forces and contact accelerations that terms asked for, in one column."""
        forces = [self.generalized_forces] if self.uses_dynamics else []
        return ca.vertcat(*forces, *self._accelerations.values())

    def frame_symbols(self) -> ca.SX:
        """Symbols of the frames that terms asked for, in one column."""
        return ca.vertcat(*[frame.stacked() for frame in self._frames.values()])

    @property
    def has_free_flyer(self) -> bool:
        """Whether the root joint is a free-flyer in world axes, and the only joint of the world."""
        model = self.robot.model
        roots = [i for i in range(1, model.njoints) if model.parents[i] == 0]
        return (
            roots == [1]
            and self.coordinates.joints[0].kind == "freeflyer"
            and model.jointPlacements[1].isIdentity()
        )
