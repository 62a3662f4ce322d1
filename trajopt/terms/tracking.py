"""Tracking of a reference motion: the cost, and references from key frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import casadi as ca
import numpy as np
import pinocchio as pin
from typing_extensions import override

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.manifold import Joint
from trajopt.dynamics.rotations import quaternion_product
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Cost

Part = Literal["all", "joints", "base"]

# Motion clips are written with few digits: norms of their rotations are one within this.
NORMALIZED = 1e-4


@checked
@dataclass(frozen=True, kw_only=True)
class TrackingCost(Cost):
    """Cost on the distance of the configuration from a reference motion.

        w |e|^2 / n        e = (xi - xi*) / u,    2 sin((xi - xi*) / 2),    2 sin(angle / 2) axis

    for plain joints and positions, for angles without whole turns, and for rotations, respectively, with the
    unit u of each coordinate, l or 1 rad. It is smooth and independent of a quaternion's sign.

    Args:
        weight: w, dimensionless.
        reference: q(t) (nq,) of nominal time in s from the schedule's start; in phases of free duration it
            stretches with the phase. Its values are parameters, so another reference needs no compilation.
        part: "all" coordinates, those of the "joints" or of the "base".

    Raises:
        InputError: for an unknown part.
    """

    reference: Motion
    part: Part = "all"

    @override
    def residual(self, context: Context, units: Units) -> ca.SX:
        coordinates = context.coordinates
        n4 = 4 * coordinates.n_rotations
        state = context.varying(partial(self._state, context), coordinates.n_node - coordinates.nv)
        goal = ca.SX.zeros(coordinates.nv)
        goal[coordinates.additive_index.tolist()] = state[n4:]
        quaternions = iter(ca.vertsplit(state[:n4], 4)) if n4 else iter(())
        parts = [ca.SX(0, 1)]
        for joint in coordinates.joints:
            quaternion = None if joint.rotation is None else next(quaternions)
            of_base = joint.v.start < BASE_ROWS[context.robot.base]
            if self.part == "all" or of_base == (self.part == "base"):
                parts.append(_distance(context, joint, goal[joint.v], quaternion, units))
        return ca.vertcat(*parts)

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        if self.part == "base" and robot.base == "fixed":
            return f"part='base', and robot '{robot.name}' is fixed to the world"
        times = self.reference.times if isinstance(self.reference, KeyFrames) else (0.0, math.inf)
        if times[0] >= schedule.duration_range[1] or times[-1] <= 0.0:
            span = f"from {times[0]:g} to {times[-1]:g} s"
            return f"its key frames are {span}, outside the schedule of {schedule.duration:g} s"
        return super().idle(robot, schedule)

    def _state(self, context: Context, t: float) -> np.ndarray:
        """The reference at time t, as rotations and additive positions in the context's coordinates."""
        coordinates = context.coordinates
        q = context.posture(self.reference(t))
        return coordinates.node_from_pinocchio(q, np.zeros(coordinates.nv))[: -coordinates.nv]


def _distance(context: Context, joint: Joint, goal: ca.SX, quaternion: ca.SX | None, units: Units) -> ca.SX:
    """Residual of a joint, from its goal in local coordinates and, for rotations, as a quaternion."""
    away = context.xi[joint.v] - goal
    if quaternion is not None:
        inverse = quaternion * ca.SX([-1, -1, -1, 1])
        turn = 2 * quaternion_product(inverse, context.q[joint.q][-4:])[:3]
        return turn if joint.kind == "spherical" else ca.vertcat(away[:3] / units.length, turn)
    if joint.kind == "continuous":
        return 2 * ca.sin(away / 2)
    if joint.kind == "planar":
        return ca.vertcat(away[:2] / units.length, 2 * ca.sin(away[2] / 2))
    return away / units.position[joint.v]


@checked
@dataclass(frozen=True, eq=False)
class KeyFrames:
    """A motion through ``configurations`` (n, nq) at ``times`` (n,), s; see `key_frames`."""

    robot: Robot
    times: np.ndarray
    configurations: np.ndarray

    def __call__(self, t: float) -> np.ndarray:
        """Configuration (nq,) at a time in s."""
        at, rows = self.times, self.configurations
        k = int(np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2))
        fraction = float(np.clip((t - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0))
        between: np.ndarray = pin.interpolate(self.robot.model, rows[k], rows[k + 1], fraction)
        return between


def key_frames(robot: Robot, times: Sequence[float], configurations: np.ndarray) -> KeyFrames:
    """A motion through key frames: geodesics between them, constant before the first and after the last.

    Args:
        robot: the robot.
        times: of the key frames (n,), s, increasing.
        configurations: at these times (n, nq).

    Raises:
        InputError: for times that do not increase, configurations of another size, and rotations that are not
            unit.
    """
    at, rows = np.array(times, dtype=float), np.atleast_2d(np.array(configurations, dtype=float))
    if at.ndim != 1 or len(at) < 2 or not np.all(np.isfinite(at)) or np.any(np.diff(at) <= 0):
        raise InputError(f"times of key frames are {times}", "allowed: two or more, finite, rising, s")
    if rows.shape != (len(at), robot.nq) or not np.all(np.isfinite(rows)):
        raise InputError(
            f"configurations of key frames have shape {rows.shape}",
            f"allowed: ({len(at)}, {robot.nq}), finite",
        )
    if not all(pin.isNormalized(robot.model, row, NORMALIZED) for row in rows):
        raise InputError("a key frame's rotation has no unit norm", "allowed: normalised configurations")
    return KeyFrames(robot, at, rows)
