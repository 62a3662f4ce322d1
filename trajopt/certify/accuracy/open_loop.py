"""Open-loop integration of the planned torques over an interval, a phase, or the whole motion.

All integrations are those of `certify.reintegration`: contact-constrained forward dynamics by numeric
Pinocchio, without stabilisation, under the torque polynomials of the file.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajopt.certify.accuracy.named_points import NamedPoints
from trajopt.certify.reintegration import RobotState, integrate_interval, integrated_states, phase_dynamics
from trajopt.motion.quantities import MotionQuantities


@dataclass(frozen=True, kw_only=True)
class OpenLoopDrift:
    """Largest distance of an integrated motion from the planned one, at nodes; inf if it diverges.

    Attributes:
        position: Distance of the base, or with a fixed base of the farthest-off named point, m.
        orientation, joints: Angle of the base, rad (None for a fixed base), and of joints, rad or m.
        farthest: Distance of the farthest-off named point, m.
    """

    position: float
    orientation: float | None
    joints: float
    farthest: float


def phase_drifts(motion: MotionQuantities) -> tuple[OpenLoopDrift, ...]:
    """Return the drift of every phase, each integrated from its planned start."""
    plan, points = motion.solution, NamedPoints.of(motion.solution.model)
    return tuple(
        _drift(motion, points, numbers, integrated_states(motion, numbers))
        for numbers in map(plan.intervals_of, range(len(plan.phases)))
    )


def motion_drift(motion: MotionQuantities) -> tuple[OpenLoopDrift, ...]:
    """Return the drift within each phase when the whole motion is integrated, through its impacts."""
    plan, points = motion.solution, NamedPoints.of(motion.solution.model)
    states = list(integrated_states(motion, range(plan.n_intervals)))
    states += [None] * (plan.n_intervals - len(states))
    return tuple(
        _drift(motion, points, numbers, iter(states[numbers.start : numbers.stop]))
        for numbers in map(plan.intervals_of, range(len(plan.phases)))
    )


def interval_drifts(motion: MotionQuantities) -> np.ndarray:
    """Return the local error (I,) in m of every interval, integrated from its own planned start.

    It is the largest |p - p_plan| + T |p' - p'_plan| of a named point at the interval's end, with the natural
    time T = sqrt(reach / g). With velocity sources only positions count. inf if the integration diverges.
    """
    plan, points = motion.solution, NamedPoints.of(motion.solution.model)
    errors = []
    for phase, samples in enumerate(plan.phases):
        dynamics = phase_dynamics(motion, samples.start)
        for number in plan.intervals_of(phase):
            rows = plan.intervals[number]
            end = integrate_interval(motion, dynamics, number, plan.q[rows.start], plan.v[rows.start])
            errors.append(math.inf if end is None else _local_error(motion, points, rows.stop - 1, end))
    return np.array(errors)


def _local_error(motion: MotionQuantities, points: NamedPoints, row: int, end: RobotState) -> float:
    plan = motion.solution
    apart = np.linalg.norm(points.positions(end[0]) - points.positions(plan.q[row]), axis=1)
    if not motion.moved_by_rates:
        faster = points.velocities(*end) - points.velocities(plan.q[row], plan.v[row])
        apart = apart + motion.units.time * np.linalg.norm(faster, axis=1)
    return float(apart.max())


def _drift(
    motion: MotionQuantities, points: NamedPoints, numbers: range, states: Iterator[RobotState | None]
) -> OpenLoopDrift:
    plan, worst, farthest = motion.solution, np.zeros(3), 0.0
    for number, state in zip(numbers, states, strict=False):
        if state is None:
            worst, farthest = np.full(3, math.inf), math.inf
            break
        row = plan.intervals[number].stop - 1
        worst = np.maximum(worst, motion.distance_from(row, state[0]))
        farthest = max(farthest, points.farthest(plan.q[row], state[0]))
    fixed = motion.base == "fixed"
    return OpenLoopDrift(
        position=farthest if fixed else float(worst[0]),
        orientation=None if fixed else float(worst[1]),
        joints=float(worst[2]),
        farthest=farthest,
    )
