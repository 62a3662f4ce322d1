"""Tasks: goals for accelerations and contact forces, as weighted least squares.

A task wants A x = b of x = (a, f), accelerations (nv,) and forces of the active contacts, by

    minimise weight |(A x - b) / unit|^2

With feedback of position and rate the wanted acceleration of a quantity y with goal y_d is (del Prete, Joint
Position and Torque Control, 2016; Wensing et al., IEEE T-RO 40, 2024, sec. IV)

    dd y = dd y_d + 2 w (d y_d - d y) + w^2 (y_d - y)

with one bandwidth w in 1/s: errors vanish in about 5 / w without overshoot. Tasks of priority 2 act only in
the null space that tasks of priority 1 leave.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.control.contact_forces import ActiveContact
from trajopt.control.robot_state import RobotState
from trajopt.dynamics.base_joint import BASE_ROWS, base_of
from trajopt.errors import InputError


@dataclass(frozen=True, kw_only=True)
class TaskRows:
    """Rows A x = b over their units: A on accelerations (n, nv), on forces (n, nf) or None, and b (n,)."""

    acceleration: np.ndarray
    value: np.ndarray
    force: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """A task, with the ``weight`` of its squared error among the tasks of the same ``priority``, 1 or 2."""

    weight: float = 1.0
    priority: int = 1

    def __post_init__(self) -> None:
        if self.priority not in (1, 2):
            raise InputError(f"priority of {type(self).__name__} is {self.priority}", "allowed: 1 or 2")

    @abstractmethod
    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows of the task at a state, with the active contacts."""


def _feedback(error: np.ndarray, rate_error: np.ndarray, wanted: np.ndarray, bandwidth: float) -> np.ndarray:
    return wanted + 2 * bandwidth * rate_error + bandwidth**2 * error


@dataclass(frozen=True, kw_only=True)
class CenterOfMassTask(Task):
    """The centre of mass follows a position, velocity and acceleration (3,), world, in m and s.

    Velocity and acceleration are zero by default; ``bandwidth`` in 1/s and ``unit`` in m/s^2, see the module.
    """

    position: np.ndarray
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bandwidth: float
    unit: float = 1.0

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows (3,) of J_c a + drift = wanted."""
        position, velocity, jacobian, drift = state.centre_of_mass()
        wanted = _feedback(
            self.position - position, self.velocity - velocity, self.acceleration, self.bandwidth
        )
        return TaskRows(acceleration=jacobian / self.unit, value=(wanted - drift) / self.unit)


@dataclass(frozen=True, kw_only=True)
class AngularMomentumTask(Task):
    """Angular momentum about the centre of mass follows a value and its rate (3,), N m s and N m, world."""

    momentum: np.ndarray
    rate: np.ndarray
    bandwidth: float
    unit: float = 1.0

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows (3,) of A_g a + drift = rate + w (momentum error)."""
        momentum, matrix, drift = state.angular_momentum()
        wanted = self.rate + self.bandwidth * (self.momentum - momentum)
        return TaskRows(acceleration=matrix / self.unit, value=(wanted - drift) / self.unit)


@dataclass(frozen=True, kw_only=True)
class FrameTask(Task):
    """A frame of the model follows a pose, velocity and acceleration (6,), world axes, by default at rest.

    ``frame`` is its name or its index in the model. The rotation error is log(R_d R') in world axes.
    ``selection`` (r, 6) has the active combinations of linear and angular rows, by default all;
    ``numpy.eye(6)[:3]`` is the position alone. ``units`` are of linear and angular rows, m/s^2 and rad/s^2.
    """

    frame: int | str
    pose: pin.SE3
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(6))
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(6))
    bandwidth: float
    selection: np.ndarray = field(default_factory=lambda: np.eye(6))
    units: tuple[float, float] = (1.0, 1.0)

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows of J a + drift = wanted."""
        frame = state.frame(self.frame)
        error = np.concatenate(
            [
                self.pose.translation - frame.placement.translation,
                pin.log3(self.pose.rotation @ frame.placement.rotation.T),
            ]
        )
        wanted = _feedback(error, self.velocity - frame.velocity, self.acceleration, self.bandwidth)
        unit = np.array([self.units[0]] * 3 + [self.units[1]] * 3)
        rows = self.selection @ (frame.jacobian / unit[:, None])
        return TaskRows(acceleration=rows, value=self.selection @ ((wanted - frame.drift) / unit))


@dataclass(frozen=True, kw_only=True)
class PostureTask(Task):
    """The degrees of freedom ``rows_of_v`` (n,) follow a configuration (nq,), v and a (nv,).

    By default v and a are zero, and the rows are all but those of a moving base. ``weights`` (n,) are factors
    on ``weight``; ``unit`` (n,) is in rad/s^2 or m/s^2.
    """

    q: np.ndarray
    v: np.ndarray | None = None
    a: np.ndarray | None = None
    bandwidth: float
    rows_of_v: np.ndarray | None = None
    weights: np.ndarray | float = 1.0
    unit: np.ndarray | float = 1.0

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows of a = wanted."""
        still, picked = np.zeros(state.model.nv), self.rows_of_v
        if picked is None:
            picked = np.arange(BASE_ROWS[base_of(state.model)], state.model.nv)
        v, a = (still if given is None else given for given in (self.v, self.a))
        error = pin.difference(state.model, state.q, self.q)[picked]
        wanted = _feedback(error, (v - state.v)[picked], a[picked], self.bandwidth)
        scale = np.broadcast_to(np.sqrt(self.weights) / self.unit, len(picked))
        jacobian = np.zeros((len(picked), state.model.nv))
        jacobian[np.arange(len(picked)), picked] = scale
        return TaskRows(acceleration=jacobian, value=scale * wanted)


@dataclass(frozen=True, kw_only=True)
class ContactForceTask(Task):
    """Forces of the active contacts are near ``wanted`` (nc, 6), N and N m, world axes, by contact index.

    ``units`` are those of forces and moments, N and N m.
    """

    wanted: np.ndarray
    units: tuple[float, float] = (1.0, 1.0)

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows of f = wanted. Raises `InputError` for a contact without a wanted force."""
        for contact in contacts:
            if not 0 <= contact.number < len(self.wanted):
                raise InputError(
                    f"ContactForceTask has no force of contact {contact.number}",
                    f"allowed: contacts 0 to {len(self.wanted) - 1}",
                )
        unit = np.array([self.units[row > 2] for c in contacts for row in range(c.dimension)])
        wanted = np.concatenate([np.zeros(0), *(self.wanted[c.number, : c.dimension] for c in contacts)])
        return TaskRows(
            acceleration=np.zeros((len(unit), state.model.nv)),
            force=np.diag(1.0 / unit),
            value=wanted / unit,
        )


@dataclass(frozen=True, kw_only=True)
class RegularisationTask(Task):
    """All accelerations are small, for strict convexity; ``unit`` (nv,) is in m/s^2 or rad/s^2."""

    unit: np.ndarray

    def rows(self, state: RobotState, contacts: Sequence[ActiveContact]) -> TaskRows:
        """Rows of a = 0."""
        return TaskRows(acceleration=np.diag(1.0 / self.unit), value=np.zeros(state.model.nv))
