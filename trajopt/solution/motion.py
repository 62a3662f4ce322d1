"""A solution as a motion at any time: the polynomials of its intervals, on the manifold.

Within an interval the highest derivative of the local coordinates is the polynomial through the collocation
points; positions and rates are its integrals from the interval's start (see ``schemes``). Where a scheme's
own weights are no such integrals (the classic schemes integrate the velocity by the rule of the
acceleration), a ramp over the interval takes up the difference, so that the motion passes through its nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.dynamics.local_motion import Local, local_from_pinocchio
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion
from trajopt.solution.solution import Solution

# Part of a phase by which a time is moved inwards to find its interval: a time at a node belongs to two.
INSIDE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Sample:
    """State and wrenches at a time: q (nq,), v, a (nv,), and f (nc, 6) as `Solution.f`."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    f: np.ndarray


@dataclass(frozen=True, kw_only=True)
class _Interval:
    """Local motion over ``span`` (start, end) in s.

    ``rotations``, ``xi``, ``rate`` at the start; coefficients of polynomials, lowest power of the fraction
    first: ``highest`` (s, nv) derivative and ``f`` (s, nc, 6); ``gap`` (2, nv) to the end of the interval.
    """

    span: tuple[float, float]
    rotations: np.ndarray
    xi: np.ndarray
    rate: np.ndarray
    highest: np.ndarray
    f: np.ndarray
    gap: np.ndarray
    order: int

    def local(self, s: float) -> Local:
        """Local coordinates at the fraction ``s`` and their first two derivatives, each (nv,)."""
        h, j = self.span[1] - self.span[0], np.arange(len(self.highest))
        value = s**j @ self.highest
        once = h * (s ** (j + 1) / (j + 1)) @ self.highest
        position = self.xi + s * s * (3 - 2 * s) * self.gap[0]
        if self.order == 1:
            slope = j[1:] * s ** (j[1:] - 1) @ self.highest[1:]
            return position + once, value, slope / h
        twice = h * h * (s ** (j + 2) / ((j + 1) * (j + 2))) @ self.highest
        return position + h * s * self.rate + twice, self.rate + once + s * self.gap[1], value


@dataclass(frozen=True)
class SolutionMotion:
    """The motion of a solution by phase and by time; a callable from t in s to a configuration (nq,)."""

    solution: Solution
    coordinates: Coordinates = field(init=False)
    _known: dict[int, _Interval] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", Coordinates(self.solution.model))

    def __call__(self, t: float) -> np.ndarray:
        """Configuration at time ``t``; before the start and after the end that of the end."""
        edges = self.solution.interval_t
        last = len(edges) - 1
        index = int(np.clip(np.searchsorted(edges[:, 0], t, side="right") - 1, 0, last))
        return self._sample(index, t).q

    def span(self, phase: int) -> tuple[float, float]:
        """Start and end of a phase, s."""
        numbers = self._numbers(phase)
        edges = self.solution.interval_t
        return float(edges[numbers[0], 0]), float(edges[numbers[-1], 1])

    def in_phase(self, phase: int, fraction: float, towards: float) -> Sample:
        """Sample at a fraction of a phase; at a node, of the interval on the side of ``towards``."""
        start, end = self.span(phase)
        numbers = self._numbers(phase)
        inner = start + (fraction + INSIDE * (towards - fraction)) * (end - start)
        found = int(np.searchsorted(self.solution.interval_t[numbers, 0], inner, side="right")) - 1
        return self._sample(int(numbers[max(found, 0)]), start + fraction * (end - start))

    def _numbers(self, phase: int) -> np.ndarray:
        rows = self.solution.phases[phase]
        return np.arange(self.solution.interval[rows.start], self.solution.interval[rows.stop - 1] + 1)

    def _sample(self, index: int, t: float) -> Sample:
        interval = self._interval(index)
        start, end = interval.span
        s = float(np.clip((t - start) / (end - start), 0.0, 1.0))
        local = (part[None] for part in interval.local(s))
        q, v, a = self.coordinates.local_to_pinocchio(interval.rotations[None], *local)
        f = np.tensordot(s ** np.arange(len(interval.f)), interval.f, axes=1)
        return Sample(q=pin.normalize(self.solution.model, q[0]), v=v[0], a=a[0], f=f)

    def _interval(self, index: int) -> _Interval:
        if index not in self._known:
            self._known[index] = self._read(index)
        return self._known[index]

    def _read(self, index: int) -> _Interval:
        solution, coordinates = self.solution, self.coordinates
        rows = solution.intervals[index]
        start, end = (float(time) for time in solution.interval_t[index])
        node = coordinates.node_from_pinocchio(solution.q[rows[0]], solution.v[rows[0]])
        rotations = node[: 4 * coordinates.n_rotations]
        points = [row for row in rows if solution.collocation[row]]
        c = (solution.t[points] - start) / (end - start)
        local = {row: self._local(rotations, row) for row in (rows[0], *points, rows[-1])}
        order = 1 if solution.meta.get("actuation") == "velocity" else 2
        xi, rate, _ = local[rows[0]]
        wrenches = solution.f[points].reshape(len(points), -1)
        without_gap = _Interval(
            span=(start, end),
            rotations=rotations,
            xi=xi,
            rate=rate,
            highest=lagrange_coefficients(c, np.array([local[row][order] for row in points])),
            f=lagrange_coefficients(c, wrenches).reshape(len(points), *solution.f.shape[1:]),
            gap=np.zeros((2, coordinates.nv)),
            order=order,
        )
        return self._closed(without_gap, local[rows[-1]])

    def _closed(self, interval: _Interval, end: Local) -> _Interval:
        """The interval with the gap that makes it end at ``end``, angles with the nearest whole turn."""
        reached = interval.local(1.0)
        position = end[0] - reached[0]
        for joint in self.coordinates.joints:
            if joint.kind in ("continuous", "planar"):
                turns = round(position[joint.v.stop - 1] / (2 * math.pi))
                position[joint.v.stop - 1] -= 2 * math.pi * turns
        rate = end[1] - reached[1] if interval.order == 2 else np.zeros_like(position)
        return _Interval(**{**vars(interval), "gap": np.array([position, rate])})

    def _local(self, rotations: np.ndarray, row: int) -> Local:
        solution = self.solution
        return local_from_pinocchio(
            self.coordinates, rotations, solution.q[row], solution.v[row], solution.a[row]
        )


def motion_of(solution: Solution) -> Motion:
    """The motion of a solution as a guess or a reference: a time in s -> configuration (nq,).

    Times before the start and after the end give the ends. Raises `UnsupportedJointError` for a model with
    joints that no problem can have.
    """
    return SolutionMotion(solution)


def lagrange_coefficients(fractions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return polynomial coefficients (s, n), lowest power first, through ``values`` (s, n)."""
    return np.linalg.solve(np.vander(fractions, increasing=True), values)


def geodesic_motion(solution: Solution, robot: Robot) -> Motion:
    """The motion of a solution as a reference or a guess for ``robot``, at its own times.

    Beyond its ends it stays. Raises `InputError` if the robot has other joints.
    """
    names = (list(solution.model.names), list(robot.model.names))
    if names[0] != names[1] or solution.model.nq != robot.nq:
        raise InputError(
            f"the solution is of a robot with joints {', '.join(names[0][1:])}",
            f"allowed: those of '{robot.name}', {', '.join(names[1][1:])}",
        )
    return solution.interpolate
