"""A solution at other times: by its intervals' polynomials, or along geodesics."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.motion.consistency import REQUESTS
from trajopt.motion.interpolation import MotionPolynomials, MotionSample, joined
from trajopt.motion.solution import Solution
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion

Sampler = Callable[[Solution, int, np.ndarray], MotionSample]
# Fraction of a phase by which a time is moved inwards to select one of the two intervals at a node.
INWARD_SHIFT = 1e-9


@dataclass(frozen=True)
class SolutionMotion:
    """The motion of a solution, by phase and by time; calling it maps t in s to a configuration (nq,)."""

    solution: Solution

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration at time ``t``, clipped to the motion."""
        number = int(self.solution.interval_at(t))
        start, end = self.solution.interval_t[number]
        fraction = np.clip([(t - start) / (end - start)], 0.0, 1.0)
        return np.asarray(self.solution.polynomials.at(np.array([number]), fraction).q[0])

    @cached_property
    def _ends(self) -> np.ndarray:
        """First and last interval (n_phases, 2) of each phase."""
        phases = map(self.solution.intervals_of, range(len(self.solution.phases)))
        return np.array([[numbers[0], numbers[-1]] for numbers in phases])

    @property
    def spans(self) -> np.ndarray:
        """Start and end (n_phases, 2) of each phase, s."""
        return np.asarray(self.solution.interval_t[self._ends, [0, 1]])

    def in_phase(
        self, phases: np.ndarray, fractions: np.ndarray, towards: np.ndarray | float
    ) -> MotionSample:
        """Return the samples at fractions of phases (K,); at nodes, of the intervals towards ``towards``."""
        plan = self.solution
        start, end = self.spans[phases].T
        inner = start + (fractions + INWARD_SHIFT * (towards - fractions)) * (end - start)
        numbers = np.searchsorted(plan.interval_t[:, 0], inner, side="right") - 1
        numbers = np.clip(numbers, *self._ends[phases].T)
        begin, close = plan.interval_t[numbers].T
        within = (start + fractions * (end - start) - begin) / (close - begin)
        return plan.polynomials.at(numbers, np.clip(within, 0.0, 1.0))


@checked
def motion_of(solution: Solution) -> Motion:
    """Return the motion of a solution as a guess or reference that maps time in s to a configuration (nq,).

    Times are clipped to the motion.
    """
    return SolutionMotion(solution)


def geodesic_motion(solution: Solution, robot: Robot) -> Motion:
    """Return a solution's motion as a reference or guess for ``robot``, along geodesics between its samples.

    Times are clipped to the motion. Raises `InputError` if the robot has other joints.
    """
    names = (list(solution.model.names), list(robot.model.names))
    if names[0] != names[1] or solution.model.nq != robot.nq:
        raise InputError(
            f"the solution is of a robot with joints {', '.join(names[0][1:])}",
            f"allowed: those of '{robot.name}', {', '.join(names[1][1:])}",
        )
    return lambda t: geodesic_configurations(solution, t)


def geodesic_configurations(solution: Solution, t: ArrayLike) -> np.ndarray:
    """Return configurations at times ``t`` (s) on geodesics between samples, for pictures.

    `Solution.sample` gives the motion itself. A scalar gives (nq,), an array (n,) gives (n, nq). Times are
    clipped to the motion; a node shared by two intervals belongs to the later one.
    """
    times, q, nodes = np.asarray(t, dtype=float), solution.q, solution.t
    last = np.clip(np.searchsorted(nodes, times.ravel(), side="right") - 1, 0, solution.n_samples - 2)
    span = nodes[last + 1] - nodes[last]
    part = np.where(span > 0, (times.ravel() - nodes[last]) / np.where(span > 0, span, 1.0), 1.0)
    rows = [
        pin.interpolate(solution.model, q[k], q[k + 1], float(s))
        for k, s in zip(last, np.clip(part, 0.0, 1.0), strict=True)
    ]
    return np.array(rows).reshape(*times.shape, q.shape[1])


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
        gain=None,
        **dict.fromkeys(REQUESTS),
        **vars(motion),
    )
