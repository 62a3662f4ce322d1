"""Crocoddyl's objective for gaits as terms of ours, and the landing that ends its schedules.

Weights are those of `SimpleQuadrupedalGaitProblem.createSwingFootModel`: each is the factor of a square in SI
units. Its penalties on friction and on the path of swinging feet are constraints of ours instead.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.robot.units import Units
from trajopt.schedule.schedule import Motion
from trajopt.terms.context import Context
from trajopt.terms.costs import NodeCost
from trajopt.terms.interfaces import Cost, NodeConstraint, NodePlace, Rows
from trajopt.terms.terminal import configuration_difference

JOINTS = 12
TORQUE, CENTRE = 1e-1, 1e6
# Of attitude, joints, velocity of the base, of the joints.
STATE = 1e1 * np.array([500.0] * 3 + [0.01] * JOINTS + [10.0] * 6 + [1.0] * JOINTS) ** 2
# Its last model has no duration: its cost counts like a second of it.
END_SECONDS = 1.0


def _over_torques(weights: np.ndarray | float, units: Units) -> np.ndarray:
    """Factors of a residual in SI units that give its squares these weights beside a `TorqueCost` of one."""
    return np.sqrt(np.asarray(weights) / (TORQUE * JOINTS)) / units.torque


def _state(context: Context, units: Units, q: np.ndarray) -> ca.SX:
    """Distance of attitude and joints from a posture (nq,), and velocities."""
    away = ca.vertcat(configuration_difference(context, q)[3:], context.v)
    return _over_torques(STATE, units) * away


@dataclass(frozen=True, kw_only=True)
class StateCost(Cost):
    """Attitude and joints near ``posture`` (nq,), low velocities, the base near the positions of ``path``."""

    posture: np.ndarray
    path: Motion

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        goal = context.varying(lambda t: self.path(t)[:3], 3)
        centre = _over_torques(CENTRE, units) * (context.xi[:3] - goal)
        residual = ca.vertcat(centre, _state(context, units, self.posture))
        return residual * np.sqrt(residual.numel())


@dataclass(frozen=True, kw_only=True)
class EndCost(NodeCost):
    """The same at the end; the position of the base (3,) m only where a ``place`` is given."""

    posture: np.ndarray
    place: tuple[float, ...] | None = None

    @override
    def quantity(self, context: Context, units: Units, place: NodePlace) -> ca.SX:
        total = ca.sumsqr(_state(context, units, self.posture))
        if self.place is not None:
            away = context.xi[:3] - context.parameter(np.array(self.place))
            total += ca.sumsqr(_over_torques(CENTRE, units) * away)
        return total * (END_SECONDS / units.time)


@dataclass(frozen=True, kw_only=True)
class LandedAtEnd(NodeConstraint):
    """Frames of feet are at ``places`` (3,) m when the schedule ends, and at rest: the next stance begins."""

    places: Mapping[str, np.ndarray]

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        frames = [context.frame(name) for name in self.places]
        expressions = [part for frame in frames for part in (frame.position, frame.velocity[:3])]
        bounds = [part for point in self.places.values() for part in (point, np.zeros(3))]
        scales = [np.full(3, units.length), units.twist[:3]] * len(frames)
        bound = np.concatenate(bounds)
        return Rows.create(ca.vertcat(*expressions), bound, bound, np.concatenate(scales))
