"""The interpolation of a solution made anew by other means: the symbolic coordinates of the transcription."""

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.dynamics.rotations import body_rate_function
from trajopt.motion.solution import Solution

Local = tuple[np.ndarray, np.ndarray, np.ndarray]


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
class SymbolicInterpolation:
    """The polynomials of a solution's intervals, read and evaluated on symbolic `Coordinates`."""

    solution: Solution
    coordinates: Coordinates = field(init=False)
    _known: dict[int, _Interval] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", Coordinates(self.solution.model))

    def sample(self, index: int, t: float) -> Sample:
        """Sample of an interval at time t, s."""
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
        order = 1 if solution.description.actuation == "velocity" else 2
        xi, rate, _ = local[rows[0]]
        wrenches = solution.f[points].reshape(len(points), -1)
        without_gap = _Interval(
            span=(start, end),
            rotations=rotations,
            xi=xi,
            rate=rate,
            highest=_coefficients(c, np.array([local[row][order] for row in points])),
            f=_coefficients(c, wrenches).reshape(len(points), *solution.f.shape[1:]),
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


def _coefficients(fractions: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.vander(fractions, increasing=True), values)


def local_from_pinocchio(
    coordinates: Coordinates, rotations: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> Local:
    """Local coordinates and their first two derivatives, each (nv,), of one state near an interval's start.

    rotations: (4 n_rotations,) quaternions (x, y, z, w) of the start. q (nq,), v, a (nv,): Pinocchio's.
    Angles of continuous and planar joints are within (-pi, pi]: q does not tell whole turns.
    """
    xi, rate, second = np.zeros(coordinates.nv), np.array(v, dtype=float), np.array(a, dtype=float)
    starts = iter(np.reshape(rotations, (-1, 4)))
    for joint in coordinates.joints:
        if joint.kind == "plain":
            xi[joint.v] = q[joint.q]
        elif joint.kind == "continuous":
            xi[joint.v] = math.atan2(q[joint.q][1], q[joint.q][0])
        elif joint.kind == "planar":
            _planar(joint, q, xi, rate, second)
        else:
            _rotating(joint, next(starts), q, xi, rate, second)
    return xi, rate, second


def _planar(joint: Joint, q: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray) -> None:
    x, y, cosine, sine = q[joint.q]
    turn = np.array([[cosine, -sine], [sine, cosine]])
    two, turning = slice(joint.v.start, joint.v.start + 2), rate[joint.v][2]
    xi[joint.v] = [x, y, math.atan2(sine, cosine)]
    linear = rate[two].copy()
    rate[two] = turn @ linear
    second[two] = turn @ (second[two] + turning * np.array([-linear[1], linear[0]]))


def _rotating(
    joint: Joint, start: np.ndarray, q: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray
) -> None:
    """A free-flyer or spherical joint: omega' = Jr theta'' + (what of it theta and theta' give alone)."""
    rows = joint.rotation
    assert rows is not None
    here = pin.Quaternion(np.array(q[joint.q][-4:])).toRotationMatrix()
    omega = rate[rows].copy()
    if joint.kind == "freeflyer":
        three = slice(joint.v.start, joint.v.start + 3)
        xi[three] = q[joint.q][:3]
        linear = rate[three].copy()
        rate[three] = here @ linear
        second[three] = here @ (second[three] + np.cross(omega, linear))
    theta = pin.log3(pin.Quaternion(np.array(start)).normalized().toRotationMatrix().T @ here)
    to_theta = np.linalg.inv(pin.Jexp3(theta))
    xi[rows], rate[rows] = theta, to_theta @ omega
    turning = body_rate_function()(theta, rate[rows], np.zeros(3))[1]
    second[rows] = to_theta @ (second[rows] - np.array(turning).ravel())
