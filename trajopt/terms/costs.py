"""Running costs at collocation points, the cost of impulses at impacts, and costs at single nodes.

Costs at nodes are linear in a quantity over its natural unit, with a minus sign if it is to be maximised.
With a weight of one, a rise by the robot's length l is worth as much as torques of m g l for sqrt(l / g).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, UnitVector, checked
from trajopt.dynamics.model_quantities import joints_of_rows
from trajopt.errors import InputError, not_among
from trajopt.robot.legs import wheel_rows
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import AtMoment, Cost, NodePlace, Term


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueCost(Cost):
    """Cost on joint torques.

        w |tau / (m g l)|^2 / nu

    with tau (nu,) the torques that the drives deliver, joint side, N m.

    Args:
        weight: w, dimensionless.
    """

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.torque / units.torque


@checked
@dataclass(frozen=True, kw_only=True)
class AccelerationCost(Cost):
    """Cost on the second derivatives of the local coordinates.

        w |xi'' / u|^2 / nv

    with xi'' (nv,) in m/s^2 or rad/s^2 and the unit u of each entry, g or g / l. For a free-flyer, xi'' is
    the linear acceleration in world axes and the angular one in the base's axes.

    Args:
        weight: w, dimensionless.
        joints_only: leave out the unactuated rows, those of the base and of passive joints.
    """

    joints_only: bool = False

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        scaled = context.ddxi / units.acceleration
        return scaled[context.robot.actuated_rows.tolist()] if self.joints_only else scaled


@checked
@dataclass(frozen=True, kw_only=True)
class JerkCost(Cost):
    """Cost on the third derivatives of the local coordinates, where jerks are the input.

        w |(d3 xi / dt3) / u|^2 / nv

    with the unit u of each entry, g sqrt(g / l) or (g / l)^(3/2).

    Args:
        weight: w, dimensionless.
    """

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.dddxi / units.jerk


@checked
@dataclass(frozen=True, kw_only=True)
class TorqueRateCost(Cost):
    """Cost on the rates of joint torques, where jerks are the input.

        w |(d tau / dt) / (m g sqrt(g l))|^2 / nu

    with tau (nu,) the torques that the drives deliver, joint side.

    Args:
        weight: w, dimensionless.
    """

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return context.rate(context.torque) * units.time / units.torque


@checked
@dataclass(frozen=True, kw_only=True)
class VelocityCost(Cost):
    """Cost on the rates of the local coordinates.

        w |xi' / u|^2 / nv

    with xi' (nv,) in m/s or rad/s and the unit u of each entry, sqrt(g l) or sqrt(g / l). For a free-flyer,
    xi' is the linear velocity in world axes and the angular one in the base's axes.

    Args:
        weight: w, dimensionless.
        joints_only: leave out the unactuated rows, those of the base and of passive joints.
    """

    joints_only: bool = False

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        scaled = context.dxi / units.velocity
        return scaled[context.robot.actuated_rows.tolist()] if self.joints_only else scaled


@checked
@dataclass(frozen=True, kw_only=True)
class PostureCost(Cost):
    """Cost on the distance of the actuated joints from a posture.

        w |(xi_j - xi_j*) / u|^2 / n

    over n actuated coordinates that are not rotations, with the unit u of each, l or 1 rad.

    Args:
        weight: w, dimensionless.
        q: the posture (nq,) of the whole robot, m and rad; default the robot's reference.
        joints: names of joints; default all actuated ones except wheels, which turn without end.

    Raises:
        InputError: for a joint that is not actuated.
    """

    q: np.ndarray | None = None
    joints: tuple[str, ...] | None = None

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        robot, coordinates = context.robot, context.coordinates
        q = robot.reference if self.q is None else context.posture(self.q)
        node = coordinates.node_from_pinocchio(q, np.zeros(robot.nv))
        n4 = 4 * coordinates.n_rotations
        additive = coordinates.additive_index
        rows = self._rows(robot)
        joints = [(i, node[n4 + row]) for row, i in enumerate(additive) if i in rows]
        target = context.parameter(np.array([value for _, value in joints]))
        selected = ca.vertcat(*[context.xi[int(i)] for i, _ in joints])
        return (selected - target) / units.position[[i for i, _ in joints]]

    def _rows(self, robot: Robot) -> list[int]:
        """Actuated rows of v of the joints."""
        rows = robot.actuated_rows.tolist()
        if self.joints is None:
            return [row for row in rows if row not in wheel_rows(robot).values()]
        owners = joints_of_rows(robot.model)
        known = list(dict.fromkeys(owners[row] for row in rows))
        if not self.joints:
            raise InputError(f"{self.name} has no joints", f"allowed: some of {', '.join(known)}")
        for name in self.joints:
            if name not in known:
                raise not_among(known, name, f"joint '{name}' of {self.name} is not actuated")
        return [row for row in rows if owners[row] in self.joints]


@checked
@dataclass(frozen=True, kw_only=True)
class WrenchCost(Cost):
    """Cost on contact wrenches.

        w sum_c (|f_c / (m g)|^2 + |n_c / (m g l)|^2) / n

    over the active contacts c, with force f_c in N and, for a sole, moment n_c in N m, in world axes, and n
    the total number of their entries. It is zero in flight.

    Args:
        weight: w, dimensionless.
    """

    acts_on_forces: ClassVar[bool] = True

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return _scaled_wrenches(context, units)


@checked
@dataclass(frozen=True, kw_only=True)
class TimeCost(Cost):
    """Cost on time itself: with free durations, minimum time.

        w T / sqrt(l / g)

    with T the total duration of the phases in which it acts, s.

    Args:
        weight: w, dimensionless.
    """

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return ca.SX(1)


@checked
@dataclass(frozen=True, kw_only=True)
class ImpulseCost(Cost):
    """Cost on the contact impulses of an impact, once at every impact.

        w sum_c (|F_c / (m sqrt(g l))|^2 + |N_c / (m l sqrt(g l))|^2) / n

    over the active contacts c, with impulse F_c in N s and, for a sole, angular impulse N_c in N m s, in
    world axes, and n the total number of their entries. It makes landings soft and the impulses of redundant
    contacts unique.

    Args:
        weight: w, dimensionless.
    """

    acts_at_points: ClassVar[bool] = False
    acts_at_impacts: ClassVar[bool] = True

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        impacts = any(phase.impact for phase in schedule.phases if self.acts_in(phase.name))
        return "" if impacts or self.phases is None else f"no impact begins phases {', '.join(self.phases)}"

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        return _scaled_wrenches(context, units)


def _scaled_wrenches(context: Context, units: Units) -> ca.SX:
    """All contact wrenches (or impulses) in one column, over their units."""
    parts = [w / units.wrench[: w.numel()] for w in context.wrenches.values()]
    return ca.vertcat(ca.SX(0, 1), *parts)


@checked
@dataclass(frozen=True, kw_only=True)
class NodeCost(Term, ABC):
    """A cost at some nodes (a Mayer term), ``w`` times its `quantity`.

    Args:
        weight: w, dimensionless, finite and at least zero.

    Raises:
        InputError: for a weight that is negative or not finite.
    """

    acts_at_points: ClassVar[bool] = False

    weight: NonNegative

    def acts_at(self, place: NodePlace) -> bool:
        """Whether the cost acts at this node; default: at the end of the schedule."""
        return place.last

    @abstractmethod
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        """Quantity over its unit, to be weighted; only parameter values may depend on ``place``."""

    def value(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        """Cost at one node."""
        return context.parameter(self.weight) * self.quantity(context, units, place)


@checked
@dataclass(frozen=True, kw_only=True)
class FrameHeightCost(AtMoment, NodeCost):
    """Reward for height: minus the height of a frame at one moment.

        -w p_z / l

    with p the frame's origin in the world.

    Args:
        weight: w, dimensionless.
        frame: name of the frame.
        at: the moment; the middle of a ballistic flight is its apex.

    Raises:
        InputError: for a negative weight.
    """

    frame: str

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        return -context.frame(self.frame).position[2] / units.length


@checked
@dataclass(frozen=True, kw_only=True)
class DistanceCost(AtMoment, NodeCost):
    """Reward for distance: minus a frame's coordinate along a direction at one moment.

        -w direction . p / l

    with p the frame's origin in the world.

    Args:
        weight: w, dimensionless.
        frame: name of the frame.
        direction: in the world (3,), normalised.
        at: the moment; default the end of the motion.

    Raises:
        InputError: for a zero vector.
    """

    frame: str
    direction: UnitVector = (1.0, 0.0, 0.0)

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        direction = context.parameter(np.array(self.direction))
        return -ca.dot(direction, context.frame(self.frame).position) / units.length
