"""A solution between its samples, by numeric Pinocchio: the polynomials of its intervals.

Within an interval the highest derivative of the local coordinates (`certify.local_states`) is the polynomial
through its values at the collocation points; rates and positions are its integrals from the interval's start,

    xi'(s) = xi'_k + h int_0^s y,        xi(s) = xi_k + h s xi'_k + h^2 int_0^s int_0^r y,

and torques and wrenches are the polynomials through theirs. Where these integrals do not end at the
interval's planned end (the classic schemes integrate the velocity by the rule of the acceleration) a ramp
over it takes up the difference, as in `solution_motion`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trajopt.solution.local_states import local_state, state_from_local
from trajopt.solution.motion import lagrange_coefficients
from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """A motion at n times: q (n, nq), v, a (n, nv), tau (n, nu), f (n, nc, 6), as in a `Solution`."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray


@dataclass(frozen=True, kw_only=True)
class _Interval:
    """Polynomials over the fraction of an interval, lowest power first, and the gap (2, nv) to its end."""

    start: np.ndarray
    rate: np.ndarray
    step: float
    order: int
    highest: np.ndarray
    tau: np.ndarray
    f: np.ndarray
    gap: np.ndarray

    def local(self, s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local coordinates relative to the start and their first two derivatives at a fraction."""
        h, j = self.step, np.arange(len(self.highest))
        value = s**j @ self.highest
        once = h * (s ** (j + 1) / (j + 1)) @ self.highest
        closing = s * s * (3 - 2 * s) * self.gap[0]
        if self.order == 1:
            return closing + once, value, (j[1:] * s ** (j[1:] - 1) @ self.highest[1:]) / h
        twice = h * h * (s ** (j + 2) / ((j + 1) * (j + 2))) @ self.highest
        return closing + h * s * self.rate + twice, self.rate + once + s * self.gap[1], value


def _read(plan: Solution, rows: range) -> _Interval:
    start, end = (float(time) for time in plan.interval_t[plan.interval[rows.start]])
    points = [row for row in rows if plan.collocation[row]]
    fractions = (plan.t[points] - start) / (end - start)
    order = 1 if plan.meta.get("actuation") == "velocity" else 2
    origin = plan.q[rows.start]

    def local(row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return local_state(plan.model, origin, plan.q[row], plan.v[row], plan.a[row])

    highest = np.array([local(row)[order] for row in points])
    open_end = _Interval(
        start=origin,
        rate=local(rows.start)[1],
        step=end - start,
        order=order,
        highest=lagrange_coefficients(fractions, highest),
        tau=lagrange_coefficients(fractions, plan.tau[points]),
        f=lagrange_coefficients(fractions, plan.f[points].reshape(len(points), -1)),
        gap=np.zeros((2, plan.model.nv)),
    )
    reached, planned = open_end.local(1.0), local(rows.stop - 1)
    gap = np.array([planned[0] - reached[0], planned[1] - reached[1]])
    gap[1] *= order == 2
    return replace(open_end, gap=gap)


Sampler = Callable[[Solution, int, np.ndarray], Sampled]


def sample_interval(plan: Solution, number: int, fractions: np.ndarray) -> Sampled:
    """The motion of one interval at ``fractions`` (n,) of it."""
    interval = _read(plan, plan.intervals[number])
    states = [
        state_from_local(plan.model, interval.start, *interval.local(float(fraction)))
        for fraction in fractions
    ]
    q, v, a = (np.array(part) for part in zip(*states, strict=True))
    powers = np.asarray(fractions, dtype=float)[:, None] ** np.arange(len(interval.tau))
    force = powers @ interval.f
    return Sampled(q=q, v=v, a=a, tau=powers @ interval.tau, f=force.reshape(len(q), *plan.f.shape[1:]))


def resampled(plan: Solution, fractions: np.ndarray, sample: Sampler = sample_interval) -> Solution:
    """The same motion with samples at ``fractions`` (n,) of every interval, each marked as a point.

    It is for figures alone: it has no impulses and no multipliers, and rows of the dynamics do not vanish at
    its points. ``fractions`` are from 0 to 1, both of which make the samples start and end with the nodes.
    ``sample`` gives those of one interval.
    """
    parts = [sample(plan, number, fractions) for number in range(plan.n_intervals)]
    first = np.repeat([rows.start for rows in plan.intervals], len(fractions))
    steps = np.diff(plan.interval_t, axis=1)
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in Sampled.__dataclass_fields__
    }
    return replace(
        plan,
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
        **arrays,
    )
