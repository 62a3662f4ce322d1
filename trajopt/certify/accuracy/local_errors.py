"""Local errors of intervals: integrate the planned torques over each, for all intervals at once.

Each interval is integrated from its planned start by Gauss collocation with more points than its scheme. The
planned motion (q, v, a)(t) is nearly a solution. With a_f the acceleration under the planned torques and e
the error of the planned motion, fixed-point iteration solves

    e''(t) = a_f(q + e, v + e', tau) - a,        e(0) = e'(0) = 0

Its first step is the quadrature of the residual, which vanishes at the scheme's own points.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.reintegration import integrated_interval_error, phase_dynamics
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.motion.quantities import MotionQuantities

# Number of quadrature points beyond those of the scheme.
MORE_POINTS = 2
# Limit of fixed-point iterations. They end if the final velocities change by less than this fraction.
MOST_SWEEPS, SWEEP_CHANGE = 6, 0.1


@dataclass(frozen=True, kw_only=True)
class LocalErrors:
    """Errors of I intervals at their ends, each from its own planned start; inf if it diverges.

    ``position`` (I,) m is |dp| + T |dp'| of the farthest-off named point with T = sqrt(reach / g), and
    ``joints`` (I,) rad the same for the farthest-off rotation, of a joint or an axis of the base.
    """

    position: np.ndarray
    joints: np.ndarray


def local_errors(motion: MotionQuantities) -> LocalErrors:
    """Return the local error of every interval of a motion."""
    plan = motion.solution
    position, speed = np.zeros((plan.n_intervals, plan.model.nv)), np.zeros((plan.n_intervals, plan.model.nv))
    for number, samples in enumerate(plan.phases):
        numbers = plan.intervals_of(number)
        inside, dynamics = slice(numbers.start, numbers.stop), phase_dynamics(motion, samples.start)
        if motion.moved_by_rates:
            errors = [integrated_interval_error(motion, dynamics, i) for i in numbers]
            position[inside], speed[inside] = (np.array(part) for part in zip(*errors, strict=True))
        else:
            position[inside], speed[inside] = _collocated(motion, dynamics, numbers)
    return _measured(motion, position, speed)


def _collocated(
    motion: MotionQuantities, dynamics: ContactDynamics, numbers: range
) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (n, nv) of positions and velocities at the ends of a phase's intervals."""
    plan = motion.solution
    first = plan.intervals[numbers.start]
    count = int(plan.collocation[first.start : first.stop].sum()) + MORE_POINTS
    fractions, once, twice = _gauss(count)
    sample = motion.polynomials.at(np.repeat(numbers, count), np.tile(fractions, len(numbers)))
    force = plan.actuation.force(sample.tau)
    step = np.diff(plan.interval_t[numbers.start : numbers.stop], axis=1)[:, None]
    q, v = sample.q, sample.v
    times = (plan.interval_t[numbers.start : numbers.stop, :1] + step[:, 0] * fractions).ravel()
    ends = np.full((len(numbers), plan.model.nv), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(MOST_SWEEPS):
            given = force + plan.known_force(times, q, v) + _contact_force(motion, q, sample.f)
            apart = (dynamics.accelerations(q, v, given) - sample.a).reshape(len(numbers), count, -1)
            faster, moved = step * (once @ apart), step**2 * (twice @ apart)
            changed, ends = np.abs(faster[:, -1] - ends).max(), faster[:, -1]
            if not changed > SWEEP_CHANGE * np.abs(ends).max():
                break
            there = moved[:, :-1].reshape(len(q), -1)
            q = np.array([pin.integrate(plan.model, *row) for row in zip(sample.q, there, strict=True)])
            v = sample.v + faster[:, :-1].reshape(len(q), -1)
        gap = motion.polynomials.gaps(np.array(numbers))
        return moved[:, -1] - gap[:, 0], faster[:, -1] - gap[:, 1]


def _contact_force(motion: MotionQuantities, q: np.ndarray, f: np.ndarray) -> np.ndarray | float:
    """Return J^T f (n, nv) of planned wrenches (n, nc, 6) at n configurations; 0 if contacts are held."""
    plan = motion.solution
    if plan.description.dynamics == "held":
        return 0.0
    contacts = [(frame, 6) for frame in plan.contact_frames]
    return np.array([
        contact_jacobian(plan.model, row, contacts).T @ wrenches.ravel()
        for row, wrenches in zip(q, f, strict=True)
    ])  # fmt: skip


@lru_cache
def _gauss(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Gauss points (n,) of [0, 1], and matrices (n + 1, n) for single and double integrals.

    The integrals of values at the points are from 0 to every point, then to 1.
    """
    points = (np.polynomial.legendre.leggauss(count)[0] + 1) / 2
    powers, ends = np.arange(count), np.append(points, 1.0)[:, None]
    coefficients = np.linalg.inv(points[:, None] ** powers)
    once = ends ** (powers + 1) / (powers + 1)
    twice = ends ** (powers + 2) / ((powers + 1) * (powers + 2))
    return points, once @ coefficients, twice @ coefficients


def _measured(motion: MotionQuantities, position: np.ndarray, speed: np.ndarray) -> LocalErrors:
    plan, seconds = motion.solution, motion.units.time
    points = NamedPoints.of(plan.model)
    ends = plan.q[[rows.stop - 1 for rows in plan.intervals]]
    apart = points.speeds(ends, position) + seconds * points.speeds(ends, speed)
    turns = (np.abs(position) + seconds * np.abs(speed))[:, motion.turning_rows]
    worst = (apart.max(axis=1), turns.max(axis=1, initial=0.0))
    position, joints = (np.where(np.isfinite(part), part, np.inf) for part in worst)
    return LocalErrors(position=position, joints=joints)
