"""How far balls that roll have come since a motion began: integrals of the velocity at which they roll."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajopt.motion.touched import TouchedSurfaces
from trajopt.solution.interpolation import collocation_fractions, lagrange_coefficients
from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class RolledPaths:
    """By interval polynomials over its fraction, lowest power first, and where they begin (nc, 3), m."""

    coefficients: tuple[np.ndarray, ...]
    begins: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, plan: Solution, velocity: np.ndarray, surfaces: TouchedSurfaces) -> RolledPaths:
        """Integrate omega x lever of twists (K, nc, 6), through the collocation points of each interval."""
        rates = np.cross(velocity[..., 3:], surfaces.lever)
        coefficients, begins = [], [np.zeros(rates.shape[1:])]
        for number, (begin, end) in enumerate(plan.interval_t):
            rows, fractions = collocation_fractions(plan.arrays, number)
            rate = lagrange_coefficients(fractions, rates[rows].reshape(len(fractions), -1))
            powers = np.arange(1, len(rate) + 1)
            coefficients.append((end - begin) * rate / powers[:, None])
            begins.append(begins[-1] + coefficients[-1].sum(axis=0).reshape(begins[0].shape))
        return cls(coefficients=tuple(coefficients), begins=tuple(begins))

    def at(self, plan: Solution) -> np.ndarray:
        """Paths (K, nc, 3) m at the samples of a plan with the same intervals."""
        begin, end = plan.interval_t[plan.interval].T
        fractions, paths = (plan.t - begin) / (end - begin), []
        for number, fraction in zip(plan.interval.tolist(), fractions, strict=True):
            powers = fraction ** np.arange(1, len(self.coefficients[number]) + 1)
            start = self.begins[number]
            paths.append(start + (powers @ self.coefficients[number]).reshape(start.shape))
        return np.array(paths)
