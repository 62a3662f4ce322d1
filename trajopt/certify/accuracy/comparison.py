"""Compare two solutions of the same problem: objectives, durations, and motions at equal times.

Times are fractions of each phase, so that motions with free durations are compared event by event.
"""

import math
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.certify.figures import figure
from trajopt.errors import InputError
from trajopt.motion.configurations import sample_interval
from trajopt.motion.interpolation import MotionSample, joined
from trajopt.motion.samples import state_distance
from trajopt.motion.solution import Solution

# Number of times in each phase, including its ends, at which motions are compared.
COMPARISON_TIMES = 101
# Smallest divisor of relative differences of objectives, in natural units.
LEAST_OBJECTIVE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Largest differences between a solution and a reference.

    Attributes:
        objective_gap: Relative difference of the objectives, see `objective_gap`.
        distance: Base position, or with a fixed base the farthest-off named point, m.
        farthest: Farthest-off named point, m.
        orientation, joints: Base orientation, rad (None for a fixed base), and joints, rad or m.
        torque, torque_rms: Largest torque difference at any time, and the root mean square over time of the
            largest at each time, over weight times reach (prismatic: weight).
        time: Duration of a phase, s.
        by_phase: ``distance`` of each phase, m.
    """

    objective_gap: float | None = figure("objective against the reference", "relative")
    distance: float = figure("position from the reference's", "m")
    farthest: float = figure("farthest-off point from the reference's", "m")
    orientation: float | None = figure("base orientation from the reference's", "rad")
    joints: float = figure("joints from the reference's", "rad, m")
    torque: float = figure("torques from the reference's", "weight, reach")
    torque_rms: float = figure("torques from the reference's, mean square", "weight, reach")
    time: float = figure("duration of a phase from the reference's", "s")
    by_phase: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class _Apart:
    """Differences in one phase: base m, base rad, joints, farthest point m; torques (n, nu); durations s."""

    state: np.ndarray
    torque: np.ndarray
    durations: tuple[float, float]


def compare(plan: Solution, reference: Solution) -> Comparison:
    """Compare two plans of one problem; raises `InputError` if robots, actuations or phases differ."""
    require_same_task(plan, reference)
    points, units = NamedPoints.of(plan.model), plan.units
    phases = [_phase(plan, reference, points, phase) for phase in range(len(plan.phases))]
    unit = plan.actuation.input_unit(units.generalized_force(plan.model))
    torques = [part.torque / unit for part in phases]
    worst = np.array([part.state for part in phases])
    fixed = plan.base == "fixed"
    distances = worst[:, 3] if fixed else worst[:, 0]
    return Comparison(
        objective_gap=objective_gap(plan, reference),
        distance=float(distances.max()),
        farthest=float(worst[:, 3].max()),
        orientation=None if fixed else float(worst[:, 1].max()),
        joints=float(worst[:, 2].max()),
        torque=float(max(np.abs(part).max(initial=0.0) for part in torques)),
        torque_rms=_mean_over_time(torques, [part.durations[1] for part in phases]),
        time=max(abs(part.durations[0] - part.durations[1]) for part in phases),
        by_phase=tuple(float(distance) for distance in distances),
    )


def objective_gap(plan: Solution, reference: Solution) -> float | None:
    """Return (J - J_ref) / max(|J_ref|, ``LEAST_OBJECTIVE``), signed; None if an objective is missing."""
    reached, best = (solution.statistics.objective for solution in (plan, reference))
    if reached is None or best is None:
        return None
    return float((reached - best) / max(abs(best), LEAST_OBJECTIVE))


def require_same_task(plan: Solution, reference: Solution) -> None:
    """Raise `InputError` unless both have the same joints, torques, actuation, and contacts in each phase."""
    sizes = [(s.q.shape[1], s.v.shape[1], s.tau.shape[1]) for s in (plan, reference)]
    if sizes[0] != sizes[1] or list(plan.model.names) != list(reference.model.names):
        raise InputError(
            "the reference is of another robot", f"one with the joints of {plan.description.robot}"
        )
    if plan.description.actuation != reference.description.actuation:
        raise InputError("the reference is of another actuation", plan.description.actuation)
    contacts = [[_touching(s, phase) for phase in s.phases] for s in (plan, reference)]
    if contacts[0] != contacts[1]:
        allowed = "; ".join(", ".join(sorted(names)) or "none" for names in contacts[0])
        raise InputError("the reference has other phases", f"contacts by phase: {allowed}")


def _touching(solution: Solution, phase: range) -> set[str]:
    return {solution.contact_frames[index] for index in np.flatnonzero(solution.active[phase.start])}


def _phase(plan: Solution, reference: Solution, points: NamedPoints, phase: int) -> _Apart:
    fractions = np.linspace(0.0, 1.0, COMPARISON_TIMES)
    planned, other = (_sampled(solution, phase, fractions) for solution in (plan, reference))
    state = np.zeros(4)
    for q, q_reference in zip(planned.q, other.q, strict=True):
        apart = [*state_distance(plan.model, q_reference, q), points.farthest(q_reference, q)]
        state = np.maximum(state, apart)
    durations = (plan.phase_durations[phase], reference.phase_durations[phase])
    return _Apart(state=state, torque=planned.tau - other.tau, durations=durations)


def _sampled(solution: Solution, phase: int, fractions: np.ndarray) -> MotionSample:
    """Sample a motion at fractions of a phase; a node belongs to the interval that it begins."""
    numbers = solution.intervals_of(phase)
    edges = solution.interval_t[numbers.start : numbers.stop]
    times = edges[0, 0] + fractions * (edges[-1, 1] - edges[0, 0])
    which = np.clip(np.searchsorted(edges[:, 0], times, side="right") - 1, 0, len(edges) - 1)
    parts = []
    for index in np.unique(which):
        start, end = edges[index]
        inner = np.clip((times[which == index] - start) / (end - start), 0.0, 1.0)
        parts.append(sample_interval(solution, numbers[index], inner))
    return MotionSample(**joined(parts))


def _mean_over_time(torques: list[np.ndarray], durations: list[float]) -> float:
    """Return the root mean square over time of the largest entry at each time."""
    squares = [np.mean(np.abs(part).max(axis=1, initial=0.0) ** 2) for part in torques]
    return math.sqrt(float(np.average(squares, weights=durations)))
