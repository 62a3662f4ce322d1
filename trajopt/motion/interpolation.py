"""Solutions between their samples by the polynomials of their intervals, without CasADi.

Within an interval, the highest derivative y of the local coordinates (see `local_states`) is the polynomial
through its values at the collocation points. Rates and positions are its integrals from the interval's start,

    xi'(s) = xi'_k + h int_0^s y,        xi(s) = xi_k + h s xi'_k + h^2 int_0^s int_0^r y,

and torques and wrenches are the polynomials through their values. If the integrals do not reach the planned
end of the interval (the classic schemes integrate the velocity by the rule of the acceleration), a linear
ramp of rates and a cubic one of positions close the gaps, so that the motion passes through its nodes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.motion.consistency import runs
from trajopt.motion.local_states import local_state, state_from_local


@dataclass(frozen=True, kw_only=True)
class MotionSample:
    """A motion at one time, or at n times with one more leading axis.

    q (nq,), v, a (nv,), tau (nu,) and f (nc, 6), as in a `Solution`.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray


@dataclass(frozen=True, kw_only=True)
class MotionPolynomials:
    """Polynomials of n intervals with s points each over the interval's fraction, lowest power first.

    numbers: (n,) of the intervals. start: (n, nq) initial configurations. rate: (n, nv) initial local rates.
    step: (n,) s. order: 2, 1 for velocity input, 3 for jerks. highest: (n, s, nv) of the first or second
    derivative, tau: (n, s, nu), f: (n, s, 6 nc) coefficients. With jerks, accelerations and torques are known
    at nodes as well, so that these have more coefficients. gap: (n, 2, nv) gaps of positions and rates at the
    ends.
    """

    model: pin.Model
    numbers: np.ndarray
    start: np.ndarray
    rate: np.ndarray
    step: np.ndarray
    order: int
    highest: np.ndarray
    tau: np.ndarray
    f: np.ndarray
    gap: np.ndarray

    @classmethod
    def of(
        cls, model: pin.Model, arrays: Mapping[str, np.ndarray], order: int, numbers: np.ndarray
    ) -> MotionPolynomials:
        """Read intervals with the same number of points; for arguments see `InterpolatedMotion.of`."""
        numbers, intervals = np.asarray(numbers), runs(arrays["interval"])
        points, fractions = (
            np.array(part)
            for part in zip(*(collocation_fractions(arrays, int(number)) for number in numbers), strict=True)
        )
        first = np.array([intervals[number].start for number in numbers])
        last = np.array([intervals[number].stop - 1 for number in numbers])
        q, v, a = (arrays[name] for name in ("q", "v", "a"))
        start = q[first]
        # Accelerations of jerks are known at nodes, too, and so are torques.
        moved, moved_at = (
            (np.c_[first, points], _with_start(fractions)) if order == 3 else (points, fractions)
        )
        driven, driven_at = (
            np.array(part)
            for part in zip(*(input_samples(arrays, int(number), order) for number in numbers), strict=True)
        )

        def local(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            origin = start if rows.ndim == 1 else start[:, None]
            return local_state(model, origin, q[rows], v[rows], a[rows])

        open_ends = cls(
            model=model,
            numbers=numbers,
            start=start,
            rate=local(first)[1],
            step=np.diff(arrays["interval_t"][numbers], axis=1)[:, 0],
            order=order,
            highest=lagrange_coefficients(moved_at, local(moved)[min(order, 2)]),
            tau=lagrange_coefficients(driven_at, arrays["tau"][driven]),
            f=lagrange_coefficients(fractions, arrays["f"][points].reshape(*points.shape, -1)),
            gap=np.zeros((len(numbers), 2, model.nv)),
        )
        reached, planned = open_ends.local(np.arange(len(numbers)), np.ones(len(numbers))), local(last)
        position = _without_turns(model, planned[0] - reached[0])
        gap = np.stack([position, (order >= 2) * (planned[1] - reached[1])], axis=1)
        return replace(open_ends, gap=gap)

    def local(self, rows: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return local coordinates and their two derivatives (k, nv) at fractions (k,) of ``rows`` (k,)."""
        h, s, j = self.step[rows, None], s[:, None], np.arange(self.highest.shape[1])
        highest, rate, gap = self.highest[rows], self.rate[rows], self.gap[rows]
        value = _sum(s**j, highest)
        once = h * _sum(s ** (j + 1) / (j + 1), highest)
        closing = s * s * (3 - 2 * s) * gap[:, 0]
        if self.order == 1:
            return closing + once, value, _sum(j[1:] * s ** (j[1:] - 1), highest[:, 1:]) / h
        twice = h * h * _sum(s ** (j + 2) / ((j + 1) * (j + 2)), highest)
        return closing + h * s * rate + twice, rate + once + s * gap[:, 1], value

    def at(self, rows: np.ndarray, fractions: np.ndarray) -> MotionSample:
        """Return the motion at ``fractions`` (k,) of intervals; ``rows`` (k,) index this record's arrays."""
        q, v, a = state_from_local(self.model, self.start[rows], *self.local(rows, fractions))
        powers = fractions[:, None] ** np.arange(self.tau.shape[1])
        f = _sum(powers[:, : self.f.shape[1]], self.f[rows]).reshape(len(q), -1, 6)
        return MotionSample(q=q, v=v, a=a, tau=_sum(powers, self.tau[rows]), f=f)


def _with_start(fractions: np.ndarray) -> np.ndarray:
    """Fractions (n, s + 1) with a zero before them."""
    return np.concatenate([np.zeros((len(fractions), 1)), fractions], axis=1)


def input_samples(arrays: Mapping[str, np.ndarray], number: int, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples through which the torques of an interval pass, and their fractions.

    They are the collocation points; with jerks the nodes as well, where torques are continuous.
    """
    points, fractions = collocation_fractions(arrays, number)
    if order < 3:
        return points, fractions
    last = fractions[-1:] < 1.0  # Radau's points contain the end
    return np.r_[points[0] - 1, points, points[-1:][last] + 1], np.r_[0.0, fractions, np.ones(1)[last]]


def _sum(powers: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    return np.asarray((powers[:, None] @ coefficients)[:, 0])


@dataclass(frozen=True, kw_only=True)
class InterpolatedMotion:
    """A plan between its samples: polynomials of its intervals, grouped by their number of points."""

    groups: tuple[MotionPolynomials, ...]

    @classmethod
    def of(cls, model: pin.Model, arrays: Mapping[str, np.ndarray], order: int) -> InterpolatedMotion:
        """Read all intervals.

        Args:
            model: The model that was optimised.
            arrays: Arrays of a `Solution` with unit quaternions.
            order: See `MotionPolynomials`.
        """
        counts = np.bincount(arrays["interval"][arrays["collocation"]], minlength=len(arrays["interval_t"]))
        if order == 3:
            known = [len(input_samples(arrays, number, order)[0]) for number in range(len(counts))]
            counts = 3 * counts + known
        alike = [np.flatnonzero(counts == s) for s in set(counts)]
        return cls(groups=tuple(MotionPolynomials.of(model, arrays, order, numbers) for numbers in alike))

    def gaps(self, numbers: np.ndarray) -> np.ndarray:
        """Return the gaps (k, 2, nv) of the intervals ``numbers`` (k,), see `MotionPolynomials`."""
        order = np.concatenate([group.numbers for group in self.groups])
        every = np.concatenate([group.gap for group in self.groups])
        return np.asarray(every[np.argsort(order)][numbers])

    def at(self, numbers: np.ndarray, fractions: np.ndarray) -> MotionSample:
        """Return the motion at ``fractions`` (k,) of the intervals ``numbers`` (k,)."""
        if len(self.groups) == 1:
            return self.groups[0].at(numbers, fractions)
        rows, parts = [], []
        for group in self.groups:
            members = np.flatnonzero(np.isin(numbers, group.numbers))
            if len(members):
                rows.append(members)
                parts.append(group.at(np.searchsorted(group.numbers, numbers[members]), fractions[members]))
        back = np.argsort(np.concatenate(rows))
        return MotionSample(**{name: array[back] for name, array in joined(parts).items()})

    def rates(self, numbers: np.ndarray, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the jerks (k, nv) of local coordinates and torque rates (k, nu) of jerk inputs."""
        widths = self.groups[0].highest.shape[2], self.groups[0].tau.shape[2]
        found = [np.zeros((len(numbers), width)) for width in widths]
        for group in self.groups:
            members = np.flatnonzero(np.isin(numbers, group.numbers))
            rows = np.searchsorted(group.numbers, numbers[members])
            for values, coefficients in zip(found, (group.highest, group.tau), strict=True):
                j = np.arange(1, coefficients.shape[1])
                powers = j * fractions[members, None] ** (j - 1) / group.step[rows, None]
                values[members] = _sum(powers, coefficients[rows, 1:])
        return found[0], found[1]


def _without_turns(model: pin.Model, apart: np.ndarray) -> np.ndarray:
    """Return differences (..., nv) without full turns of the angles that q stores as cosine and sine."""
    for joint in list(model.joints)[1:]:
        if joint.shortname() == "JointModelPlanar" or (joint.nq, joint.nv) == (2, 1):
            angle = joint.idx_v + joint.nv - 1
            apart[..., angle] -= 2 * math.pi * np.round(apart[..., angle] / (2 * math.pi))
    return apart


def collocation_fractions(arrays: Mapping[str, np.ndarray], number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the collocation points of an interval: sample indices (s,) and fractions (s,)."""
    points = np.flatnonzero(arrays["collocation"] & (arrays["interval"] == number))
    start, end = arrays["interval_t"][number]
    return points, (arrays["t"][points] - start) / (end - start)


def lagrange_coefficients(fractions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return polynomial coefficients (..., s, n), lowest power first, through ``values`` (..., s, n).

    fractions: (..., s).
    """
    return np.linalg.solve(fractions[..., None] ** np.arange(fractions.shape[-1]), values)


def joined(parts: Sequence[MotionSample]) -> dict[str, np.ndarray]:
    """Return the concatenated arrays of several motions, by name."""
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
