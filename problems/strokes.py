"""Strokes on a plane that a tool follows, and its direction meanwhile."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.robot import Units
from trajopt.terms import Context, NodeConstraint, NodePlace, PointConstraint, Rows, free_directions
from trajopt.terrain import smooth_step


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """A path in a plane: ``centre`` (3,) m; ``across``, ``along`` (3,) are unit vectors in it, world."""

    shape: str
    size: float
    centre: np.ndarray
    across: np.ndarray
    along: np.ndarray

    def __call__(self, part: float) -> np.ndarray:
        """Position (3,) m at a fraction ``part`` of the path, 0 to 1: side to side, or once around."""
        if self.shape == "line":
            return np.asarray(self.centre + (part - 0.5) * self.size * self.across)
        turn = 2 * math.pi * part
        return np.asarray(self.centre + self.size / 2 * self._direction(turn))

    def acceleration(self, t: float, duration: float) -> np.ndarray:
        """Second derivative (3,) m/s^2 of the position at part 10 s^3 - 15 s^4 + 6 s^5, s = t / duration."""
        s = min(max(t / duration, 0.0), 1.0)
        rate = 30 * (s * (1 - s)) ** 2 / duration
        change = 60 * s * (1 - s) * (1 - 2 * s) / duration**2
        if self.shape == "line":
            return np.asarray(change * self.size * self.across)
        turn = 2 * math.pi * float(smooth_step(s))
        forward, inward = self._direction(turn + math.pi / 2), -self._direction(turn)
        circling = 2 * math.pi * change * forward + (2 * math.pi * rate) ** 2 * inward
        return np.asarray(self.size / 2 * circling)

    def _direction(self, turn: float) -> np.ndarray:
        """Unit vector (3,) from the centre of a circle to the point at ``turn`` rad."""
        return math.sin(turn) * self.across - math.cos(turn) * self.along

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return self.size if self.shape == "line" else math.pi * self.size


@dataclass(frozen=True, kw_only=True)
class StrokeMotion(PointConstraint):
    """A contact that slides follows the stroke in ``duration`` s, smoothly from rest to rest.

    Its acceleration within the plane is that of the stroke at the point's time, J a + Jdot v = x'': the same
    level as the constraints of other contacts. From a start on the stroke at rest its position follows to
    the accuracy of the scheme; constraints on positions, at points or at nodes, make accelerations oscillate.
    """

    contact: str
    stroke: Stroke
    duration: float

    @override
    def rows(self, context: Context, units: Units) -> Rows | None:
        acceleration = context.contact_acceleration(context.contact(self.contact))
        axes = np.array([self.stroke.across, self.stroke.along])
        wanted = context.varying(lambda t: axes @ self.stroke.acceleration(t, self.duration), 2)
        off = ca.mtimes(context.parameter(axes), acceleration) - wanted
        return Rows.create(off, 0.0, 0.0, units.contact_acceleration[0])


@dataclass(frozen=True, kw_only=True)
class RestOnStroke(NodeConstraint):
    """At the end the joints rest, at ``q`` (nq,), in the directions that the contacts leave free.

    `TerminalRest` would also stop the sliding contact, which the stroke does already.
    """

    q: np.ndarray

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        basis = free_directions(context.robot, self.q, place.phase.contacts)
        rates = context.dxi / units.velocity
        return Rows.create(ca.mtimes(context.parameter(basis).T, rates), 0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Facing(NodeConstraint):
    """An ``axis`` (3,) of a frame is within ``angle`` rad of ``direction`` (3,), world, at every node."""

    frame: str
    axis: np.ndarray
    direction: np.ndarray
    angle: float

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return place.index > 0

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        axis, direction = context.parameter(self.axis), context.parameter(self.direction)
        cosine = ca.dot(direction, ca.mtimes(context.frame(self.frame).rotation, axis))
        return Rows.create(cosine, math.cos(self.angle), np.inf, 1.0)
