"""What the planned torques do, integrated: over an interval, a phase, or the whole motion.

All integrations are those of `certify.reintegration`: contact-constrained forward dynamics by numeric
Pinocchio, without stabilisation, under the torque polynomials of the file. Impacts follow the law of
`dynamics.impact`,

    M (v+ - v-) = J^T Lambda,     J v+ = 0,

at the state that is reached, not at the planned one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.certify.accuracy.natural_units import NaturalUnits
from trajopt.certify.contact.impact import impact
from trajopt.certify.payloads import carrying_model
from trajopt.certify.reintegration import (
    PhaseDynamics,
    active_contacts,
    follow_rates,
    integrate_interval,
    phase_dynamics,
    state_distance,
)
from trajopt.dynamics.base_joint import base_of
from trajopt.errors import InputError
from trajopt.solution.solution import Solution

State = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Largest distance of an integrated motion from the planned one, at nodes; inf where it ran away.

    position: m, of the base, or with a fixed base of the farthest-off named point. orientation: rad, of the
    base; None for a fixed one. joints: rad or m. farthest: m, of the farthest-off named point of the robot.
    """

    position: float
    orientation: float | None
    joints: float
    farthest: float


def phase_drifts(plan: Solution) -> tuple[Drift, ...]:
    """Drift of every phase, each integrated from its planned start."""
    points = NamedPoints.of(plan.model)
    return tuple(
        _drift(plan, points, _intervals_of(plan, phase), _states(plan, _intervals_of(plan, phase)))
        for phase in plan.phases
    )


def motion_drift(plan: Solution) -> tuple[Drift, ...]:
    """Drift within every phase of the whole motion in one integration, through its impacts."""
    points = NamedPoints.of(plan.model)
    states = list(_states(plan, range(plan.n_intervals)))
    states += [None] * (plan.n_intervals - len(states))
    return tuple(
        _drift(plan, points, numbers, iter(states[numbers.start : numbers.stop]))
        for numbers in (_intervals_of(plan, phase) for phase in plan.phases)
    )


def interval_drifts(plan: Solution) -> np.ndarray:
    """Local error (I,) in m of every interval, integrated from its own planned start.

    The largest over the robot's named points of |p - p_plan| + T |p' - p'_plan| at the interval's end, with
    the natural time T = sqrt(reach / g): an error of the velocity counts by the way that it makes within T.
    Of a velocity source positions alone count. inf where the integration runs away.
    """
    points = NamedPoints.of(plan.model)
    seconds = NaturalUnits.of(plan.model).time
    found = []
    for phase in plan.phases:
        dynamics = phase_dynamics(plan, phase.start)
        for number in _intervals_of(plan, phase):
            rows = plan.intervals[number]
            end = _step(plan, dynamics, rows, plan.q[rows.start], plan.v[rows.start])
            found.append(math.inf if end is None else _local_error(plan, points, rows.stop - 1, end, seconds))
    return np.array(found)


def _local_error(plan: Solution, points: NamedPoints, row: int, end: State, seconds: float) -> float:
    apart = np.linalg.norm(points.positions(end[0]) - points.positions(plan.q[row]), axis=1)
    if plan.meta.get("actuation") != "velocity":
        faster = points.velocities(*end) - points.velocities(plan.q[row], plan.v[row])
        apart = apart + seconds * np.linalg.norm(faster, axis=1)
    return float(apart.max())


def _intervals_of(plan: Solution, phase: range) -> range:
    return range(int(plan.interval[phase.start]), int(plan.interval[phase.stop - 1]) + 1)


def _states(plan: Solution, numbers: range) -> Iterator[State | None]:
    """States at the ends of intervals, integrated from the planned start of the first; None is the last."""
    first = plan.intervals[numbers.start].start
    q, v = plan.q[first].copy(), plan.v[first].copy()
    impacts = set() if plan.impact_index is None else {int(row) for row in plan.impact_index}
    dynamics, phase = phase_dynamics(plan, first), plan.phase[first]
    for number in numbers:
        rows = plan.intervals[number]
        if plan.phase[rows.start] != phase:
            dynamics, phase = phase_dynamics(plan, rows.start), plan.phase[rows.start]
        if rows.start in impacts and rows.start != first:
            after = _after_impact(plan, rows.start, q, v)
            if after is None:
                yield None
                return
            v = after
        end = _step(plan, dynamics, rows, q, v)
        yield end
        if end is None:
            return
        q, v = end


def _after_impact(plan: Solution, row: int, q: np.ndarray, v: np.ndarray) -> np.ndarray | None:
    model = carrying_model(plan, int(plan.phase[row]))
    try:
        return impact(model, q, v, active_contacts(plan, model, row)).velocity
    except (InputError, np.linalg.LinAlgError):  # a state that has run away
        return None


def _step(plan: Solution, dynamics: PhaseDynamics, rows: range, q: np.ndarray, v: np.ndarray) -> State | None:
    if plan.meta.get("actuation") == "velocity":
        return follow_rates(plan, rows, q)
    return integrate_interval(plan, dynamics, rows, q, v)


def _drift(plan: Solution, points: NamedPoints, numbers: range, states: Iterator[State | None]) -> Drift:
    worst, farthest = np.zeros(3), 0.0
    for number, state in zip(numbers, states, strict=False):
        if state is None:
            worst, farthest = np.full(3, math.inf), math.inf
            break
        planned = plan.q[plan.intervals[number].stop - 1]
        worst = np.maximum(worst, state_distance(plan.model, planned, state[0]))
        farthest = max(farthest, points.farthest(planned, state[0]))
    fixed = base_of(plan.model) == "fixed"
    return Drift(
        position=farthest if fixed else float(worst[0]),
        orientation=None if fixed else float(worst[1]),
        joints=float(worst[2]),
        farthest=farthest,
    )
