"""A solution between its samples, by numeric Pinocchio: the polynomials of its intervals.

Within an interval the highest derivative y of the local coordinates (see `local_states`) is the polynomial
through its values at the collocation points; rates and positions are its integrals from the interval's start,

    xi'(s) = xi'_k + h int_0^s y,        xi(s) = xi_k + h s xi'_k + h^2 int_0^s int_0^r y,

and torques and wrenches are the polynomials through theirs. Where these integrals do not end at the
interval's planned end (the classic schemes integrate the velocity by the rule of the acceleration) a linear
ramp closes the gap, so that the motion passes through its nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.solution.local_states import local_state, state_from_local
from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class MotionSample:
    """A motion at one time, or at n times with one more axis in front.

    q (nq,), v, a (nv,), tau (nu,) and f (nc, 6), as in a `Solution`.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray


@dataclass(frozen=True, kw_only=True)
class IntervalInterpolant:
    """The polynomials of one interval over its fraction, lowest power first; see `interval_interpolant`.

    start: (nq,) configuration at the start. rate: (nv,) local rates there. step: s. order: 2, or 1 where the
    rates are the highest derivative. highest: (s, nv), tau: (s, nu), f: (s, 6 nc). gap: (2, nv) of positions
    and rates at the end.
    """

    model: pin.Model
    start: np.ndarray
    rate: np.ndarray
    step: float
    order: int
    highest: np.ndarray
    tau: np.ndarray
    f: np.ndarray
    gap: np.ndarray

    def local(self, s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return local coordinates relative to the start and their first two derivatives at a fraction."""
        h, j = self.step, np.arange(len(self.highest))
        value = s**j @ self.highest
        once = h * (s ** (j + 1) / (j + 1)) @ self.highest
        closing = s * s * (3 - 2 * s) * self.gap[0]
        if self.order == 1:
            return closing + once, value, (j[1:] * s ** (j[1:] - 1) @ self.highest[1:]) / h
        twice = h * h * (s ** (j + 2) / ((j + 1) * (j + 2))) @ self.highest
        return closing + h * s * self.rate + twice, self.rate + once + s * self.gap[1], value

    def at(self, fractions: np.ndarray) -> MotionSample:
        """Return the motion at ``fractions`` (n,) of the interval."""
        states = [state_from_local(self.model, self.start, *self.local(float(s))) for s in fractions]
        q, v, a = (np.array(part) for part in zip(*states, strict=True))
        powers = np.asarray(fractions, dtype=float)[:, None] ** np.arange(len(self.tau))
        return MotionSample(q=q, v=v, a=a, tau=powers @ self.tau, f=(powers @ self.f).reshape(len(q), -1, 6))


def interval_interpolant(plan: Solution, number: int) -> IntervalInterpolant:
    """Return the polynomials of the interval ``number`` of a plan whose rotations have unit norm."""
    rows, model = plan.intervals[number], plan.model
    points, fractions = collocation_fractions(plan, number)
    order = 1 if plan.meta.get("actuation") == "velocity" else 2
    start = plan.q[rows.start]

    def local(row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return local_state(model, start, plan.q[row], plan.v[row], plan.a[row])

    open_end = IntervalInterpolant(
        model=model,
        start=start,
        rate=local(rows.start)[1],
        step=float(plan.interval_t[number, 1]) - float(plan.interval_t[number, 0]),
        order=order,
        highest=lagrange_coefficients(fractions, np.array([local(row)[order] for row in points])),
        tau=lagrange_coefficients(fractions, plan.tau[points]),
        f=lagrange_coefficients(fractions, plan.f[points].reshape(len(points), -1)),
        gap=np.zeros((2, model.nv)),
    )
    reached, planned = open_end.local(1.0), local(rows.stop - 1)
    position = _without_turns(model, planned[0] - reached[0])
    return replace(open_end, gap=np.array([position, (order == 2) * (planned[1] - reached[1])]))


def _without_turns(model: pin.Model, apart: np.ndarray) -> np.ndarray:
    """The difference (nv,) without whole turns of the angles that q stores as cosine and sine."""
    for joint in list(model.joints)[1:]:
        if joint.shortname() == "JointModelPlanar" or (joint.nq, joint.nv) == (2, 1):
            angle = joint.idx_v + joint.nv - 1
            apart[angle] -= 2 * math.pi * round(apart[angle] / (2 * math.pi))
    return apart


def collocation_fractions(plan: Solution, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples (s,) of an interval that are its collocation points, and their fractions of it."""
    rows = plan.intervals[number]
    points = rows.start + np.flatnonzero(plan.collocation[rows.start : rows.stop])
    start, end = plan.interval_t[number]
    return points, (plan.t[points] - start) / (end - start)


def lagrange_coefficients(fractions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return polynomial coefficients (s, n), lowest power first, through ``values`` (s, n)."""
    return np.linalg.solve(np.vander(fractions, increasing=True), values)


Sampler = Callable[[Solution, int, np.ndarray], MotionSample]


def sample_interval(plan: Solution, number: int, fractions: np.ndarray) -> MotionSample:
    """Return the motion of one interval at ``fractions`` (n,) of it."""
    return interval_interpolant(plan, number).at(fractions)


def joined(parts: Sequence[MotionSample]) -> dict[str, np.ndarray]:
    """Return the concatenated arrays of motions, by name."""
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}


def resampled(plan: Solution, fractions: np.ndarray, sample: Sampler = sample_interval) -> Solution:
    """Return the same motion with samples at fractions of every interval, each marked as a point.

    It serves figures only: it has no impulses and no multipliers, and rows of the dynamics do not vanish at
    its points.

    Args:
        plan: the motion, with unit rotations.
        fractions: (n,) from 0 to 1, including both so that the samples start and end at nodes.
        sample: gives the samples of one interval.
    """
    parts = [sample(plan, number, fractions) for number in range(plan.n_intervals)]
    first = np.repeat([rows.start for rows in plan.intervals], len(fractions))
    steps = np.diff(plan.interval_t, axis=1)
    return plan.with_arrays(
        t=(plan.interval_t[:, :1] + steps * fractions).ravel(),
        phase=plan.phase[first],
        interval=plan.interval[first],
        active=plan.active[first],
        collocation=np.ones(len(first), dtype=bool),
        impulse=None,
        impact_index=None,
        row_multiplier=None,
        row_place=None,
        bound_multiplier=None,
        **joined(parts),
    )
