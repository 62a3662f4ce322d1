"""Open-loop re-integration: the motion that the planned torques produce, by numeric Pinocchio alone.

Within an interval the torque is the Lagrange polynomial through its collocation points. With the
active contacts of the interval the acceleration solves

    M a + h = S^T tau + J^T f,      J a + Jdot v = 0                                    (KKT)

(Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8). There is no stabilisation, so a plan that
is inconsistent between its points drifts away here. States are integrated on the manifold, q = q_k (+) delta,
with the eighth-order method of Dormand and Prince. Impacts follow the law of
`contact.impact`, M (v+ - v-) = J^T Lambda, J v+ = 0.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.certify.contact.contact_dynamics import ContactDynamics
from trajopt.certify.contact.contact_set import ContactSet
from trajopt.certify.contact.impact import impact
from trajopt.certify.runge_kutta import METHOD, integrate
from trajopt.certify.sliding import SlidingDynamics
from trajopt.errors import InputError
from trajopt.motion.quantities import MotionQuantities

RobotState = tuple[np.ndarray, np.ndarray]

# Far below the errors that are measured (1e-6 at best), far above rounding.
RELATIVE_ERROR = 1e-10
# Far below what a verdict allows (1e-3), even for a phase that amplifies errors as much as a stable one may.
ROUGH_ERROR = 1e-7
# Ratio of absolute to relative error tolerance.
ABSOLUTE_SHARE = 1e-2
# An interval of a sane plan takes about five steps of a dozen evaluations. One that needs this many has
# diverged, or has accelerations that are rounding noise, as of joints that move no mass.
MAX_EVALUATIONS = 3600


class _RunAwayError(Exception):
    """An integration takes too many evaluations."""


@dataclass(frozen=True, kw_only=True)
class OpenLoopError:
    """Largest error at the nodes of a phase: base m and rad (None for a fixed base), joints rad or m."""

    position: float | None
    orientation: float | None
    joints: float


def open_loop(
    motion: MotionQuantities,
    phase: int,
    relative_error: float = RELATIVE_ERROR,
    most: tuple[float, float] | None = None,
) -> OpenLoopError | None:
    """Integrate a phase from its first sample with the planned torques; return the errors at its nodes.

    With velocity sources the planned rates are integrated instead. Errors are inf if the integration diverges
    before the phase ends. ``relative_error`` is the tolerance of each integration step. If the errors of
    position (m) or rotations (rad) exceed ``most``, the integration stops and the result is None.
    """
    plan = motion.solution
    numbers, worst = plan.intervals_of(phase), np.zeros(3)
    for number, state in zip(numbers, integrated_states(motion, numbers, relative_error), strict=False):
        if state is None:
            worst[:] = np.inf
            break
        worst = np.maximum(worst, motion.distance_from(plan.intervals[number].stop - 1, state[0]))
        if most is not None and (worst[0] > most[0] or worst[1:].max() > most[1]):
            return None
    if motion.base == "fixed":
        return OpenLoopError(position=None, orientation=None, joints=float(worst[2]))
    return OpenLoopError(position=float(worst[0]), orientation=float(worst[1]), joints=float(worst[2]))


def integrated_states(
    motion: MotionQuantities, numbers: range, relative_error: float = RELATIVE_ERROR
) -> Iterator[RobotState | None]:
    """Yield the states (q, v) at the ends of intervals, integrated from the planned start of the first.

    The impact law is applied to the integrated state. If the integration diverges, the last state is None.
    """
    plan = motion.solution
    first = plan.intervals[numbers.start].start
    q, v = plan.q[first].copy(), plan.v[first].copy()
    impacts = set() if plan.impact_index is None else {int(row) for row in plan.impact_index}
    dynamics, phase = phase_dynamics(motion, first), plan.phase[first]
    for number in numbers:
        row = plan.intervals[number].start
        if plan.phase[row] != phase:
            dynamics, phase = phase_dynamics(motion, row), plan.phase[row]
        if row in impacts and row != first:
            after = _after_impact(motion, row, q, v)
            if after is None:
                yield None
                return
            v = after
        end = integrate_interval(motion, dynamics, number, q, v, relative_error)
        yield end
        if end is None:
            return
        q, v = end


def _after_impact(motion: MotionQuantities, row: int, q: np.ndarray, v: np.ndarray) -> np.ndarray | None:
    model = motion.models[int(motion.solution.phase[row])]
    try:
        return impact(model, q, v, active_contacts(motion, row)).velocity
    except (InputError, np.linalg.LinAlgError):  # a state that has diverged
        return None


def integrate_interval(
    motion: MotionQuantities,
    dynamics: ContactDynamics,
    number: int,
    q: np.ndarray,
    v: np.ndarray,
    relative_error: float = RELATIVE_ERROR,
) -> RobotState | None:
    """Integrate one interval from ``q``, ``v`` with its torques and contacts; None if it diverges.

    With velocity sources the polynomials of the planned rates are integrated and ``v`` is ignored.
    """
    plan, model, nv = motion.solution, motion.solution.model, motion.solution.model.nv
    start, end = (float(time) for time in plan.interval_t[number])
    coefficients, powers = motion.inputs[number], np.arange(len(motion.inputs[number]))
    compiled = dynamics.compiled
    if compiled is not None and not (motion.moved_by_rates or plan.description.joint_forces):
        absolute = ABSOLUTE_SHARE * relative_error
        actuation, duration = plan.actuation.matrix, end - start
        for index, wrench in enumerate(plan.description.wrenches):
            fractions, frame = (wrench.times - start) / duration, model.getFrameId(wrench.frame)
            compiled.load(index, frame, wrench.point, fractions, np.hstack([wrench.force, wrench.torque]))
        finite, reached = compiled.integrate(
            METHOD, q, v, coefficients, actuation, duration, relative_error, absolute, MAX_EVALUATIONS
        )
        return reached if finite else None

    def coordinate_rate(delta: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return np.linalg.solve(pin.dIntegrate(model, q, delta, pin.ArgumentPosition.ARG1), velocity)

    def kinematics(fraction: float, delta: np.ndarray) -> np.ndarray:
        return (end - start) * coordinate_rate(delta, fraction**powers @ coefficients)

    def dynamic(fraction: float, state: np.ndarray) -> np.ndarray:
        delta, velocity = state[:nv], state[nv:]
        moved = pin.integrate(model, q, delta)
        force = plan.actuation.force(fraction**powers @ coefficients)
        force = force + plan.known_force(start + fraction * (end - start), moved, velocity)
        acceleration = dynamics.acceleration(moved, velocity, force)
        return (end - start) * np.concatenate([coordinate_rate(delta, velocity), acceleration])

    if motion.moved_by_rates:
        final = _run(kinematics, np.zeros(nv), relative_error)
        return None if final is None else (pin.integrate(model, q, final), coefficients.sum(axis=0))
    final = _run(dynamic, np.concatenate([np.zeros(nv), v]), relative_error)
    return None if final is None else (pin.integrate(model, q, final[:nv]), final[nv:])


def integrated_interval_error(
    motion: MotionQuantities, dynamics: ContactDynamics, number: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (nv,) of position and velocity at an interval's end, from its planned start.

    They are NaN if the integration diverges. With velocity sources the velocity has no error.
    """
    plan = motion.solution
    rows = plan.intervals[number]
    end = integrate_interval(motion, dynamics, number, plan.q[rows.start], plan.v[rows.start])
    if end is None:
        return np.full(plan.model.nv, np.nan), np.full(plan.model.nv, np.nan)
    apart = pin.difference(plan.model, plan.q[rows.stop - 1], end[0])
    return apart, np.zeros(plan.model.nv) if motion.moved_by_rates else end[1] - plan.v[rows.stop - 1]


def _run(
    rate: Callable[[float, np.ndarray], np.ndarray], state: np.ndarray, relative_error: float
) -> np.ndarray | None:
    """Integrate from 0 to 1; return None if it takes too many evaluations or is not finite."""
    left = itertools.count(MAX_EVALUATIONS, -1)

    def counted(fraction: float, state: np.ndarray) -> np.ndarray:
        if not next(left):  # evaluations are counted, since steps may be rejected for ever
            raise _RunAwayError
        return rate(fraction, state)

    try:
        with np.errstate(over="ignore", invalid="ignore"):
            absolute = ABSOLUTE_SHARE * relative_error
            return integrate(counted, state, relative=relative_error, absolute=absolute)
    except (ValueError, np.linalg.LinAlgError, _RunAwayError):
        return None


def phase_dynamics(motion: MotionQuantities, row: int) -> ContactDynamics:
    """Return the dynamics of a sample's phase, with its active contacts and payload.

    If the planned forces are given, no contact is held.
    """
    phase = int(motion.solution.phase[row])
    model = motion.models[phase]
    forced = motion.solution.description.dynamics != "held"
    held = ContactSet.of(model, []) if forced else active_contacts(motion, row)
    described = motion.solution.description.surfaces
    surfaces = described[phase] if described else {}
    sliding = {
        index: surfaces[frame]
        for index, frame in enumerate(held.names)
        if frame in surfaces and surfaces[frame].slip_speed is not None
    }
    follow = motion.solution.actuation.independent if motion.solution.description.mimics else None
    return SlidingDynamics(model, held, sliding) if sliding else ContactDynamics(model, held, follow)


def active_contacts(motion: MotionQuantities, row: int) -> ContactSet:
    """Return the active contacts at a sample, on the model with the payload of its phase."""
    solution = motion.solution
    kinds = zip(solution.description.contacts, solution.active[row], strict=True)
    contacts = [(contact.frame, 6 if contact.is_sole else 3) for contact, on in kinds if on]
    return ContactSet.of(
        motion.models[int(solution.phase[row])],
        contacts,
        moment_arm=motion.reach or None,
        levers=[*motion.surfaces.lever[row, solution.active[row]]],
    )
