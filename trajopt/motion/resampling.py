"""The same motion resampled at fractions of its intervals, for figures and plots."""

from collections.abc import Callable

import numpy as np

from trajopt.motion.arrays import REQUESTS
from trajopt.motion.interpolation import MotionPolynomials, MotionSample, joined
from trajopt.motion.solution import Solution

Sampler = Callable[[Solution, int, np.ndarray], MotionSample]


def sample_interval(plan: Solution, number: int, fractions: np.ndarray) -> MotionSample:
    """Return the motion of one interval at fractions (n,) of it."""
    polynomials = MotionPolynomials.of(plan.model, plan.arrays, plan.order, np.array([number]))
    return polynomials.at(np.zeros(len(fractions), dtype=int), np.asarray(fractions, dtype=float))


def resampled(plan: Solution, fractions: np.ndarray, sample: Sampler | None = None) -> Solution:
    """Return the same motion with samples at fractions of every interval, see `samples_at`.

    Args:
        plan: The motion, with unit quaternions.
        fractions: (n,) from 0 to 1, including both, so that the samples start and end at nodes.
        sample: Function that samples one interval; default: its polynomials.
    """
    numbers = np.repeat(np.arange(plan.n_intervals), len(fractions))
    every = np.tile(fractions, plan.n_intervals)
    if sample is None:
        return samples_at(plan, numbers, every, plan.polynomials.at(numbers, every))
    parts = [sample(plan, number, fractions) for number in range(plan.n_intervals)]
    return samples_at(plan, numbers, every, MotionSample(**joined(parts)))


def samples_at(plan: Solution, numbers: np.ndarray, fractions: np.ndarray, motion: MotionSample) -> Solution:
    """Return ``plan`` with samples at ``fractions`` (n,) of intervals ``numbers`` (n,), for figures only.

    Samples are marked as collocation points, although the dynamics do not hold there; it has no impulses and
    no multipliers.
    """
    first = np.array([rows.start for rows in plan.intervals])[numbers]
    steps = np.diff(plan.interval_t, axis=1)[numbers, 0]
    return plan.with_arrays(
        t=plan.interval_t[numbers, 0] + steps * fractions,
        phase=plan.phase[first],
        interval=plan.interval[first],
        active=plan.active[first],
        collocation=np.ones(len(first), dtype=bool),
        impulse=None,
        impact_index=None,
        row_multiplier=None,
        row_place=None,
        bound_multiplier=None,
        **dict.fromkeys(REQUESTS),
        **vars(motion),
    )
