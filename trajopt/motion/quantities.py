"""All quantities along a motion by numeric Pinocchio, each computed on first use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import Base, position_limits
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.dynamics.virtual_base import gimbal_margin_along
from trajopt.motion.body_distances import FileBodies, missing_shapes
from trajopt.motion.configurations import samples_at
from trajopt.motion.cycles import periodicity_error
from trajopt.motion.interpolation import (
    InterpolatedMotion,
    collocation_fractions,
    input_samples,
    lagrange_coefficients,
)
from trajopt.motion.local_states import local_state
from trajopt.motion.samples import (
    ContactPlaces,
    SampleQuantities,
    contact_places,
    sample_quantities,
    state_distance,
)
from trajopt.motion.solution import Solution
from trajopt.motion.touched import TouchedSurfaces, held_part, touched_surfaces, without_rolling
from trajopt.motion.traces import Trace, Traces, joints_of, names_of_inputs, names_of_rows
from trajopt.robot.building import reach
from trajopt.robot.natural_units import NaturalUnits, turning_rows


class MotionQuantities:
    """Quantities along a solution with K samples, I intervals and nc contacts, SI units.

    Args:
        solution: The motion, with unit quaternions.
        bodies: The bodies whose distances are measured; default: those of the solution.
        rolled: The distances that contacts have rolled; default: from the solution's velocities.
    """

    def __init__(
        self, solution: Solution, bodies: FileBodies | None = None, rolled: RolledPaths | None = None
    ) -> None:
        self.solution = solution
        self._given_bodies, self._given_paths = bodies, rolled

    @classmethod
    def normalized(cls, solution: Solution) -> MotionQuantities:
        """Return the quantities of a solution after normalising its rotations."""
        return cls(solution.normalized())

    def between(self, numbers: np.ndarray, fractions: np.ndarray) -> MotionQuantities:
        """Return the same motion sampled at fractions (n,) of intervals (n,), see `samples_at`."""
        samples = self.polynomials.at(numbers, fractions)
        solution = samples_at(self.solution, numbers, fractions, samples)
        return MotionQuantities(solution, self.bodies, self.rolled_paths)

    @property
    def polynomials(self) -> InterpolatedMotion:
        """The motion at any time, by polynomials."""
        return self.solution.polynomials

    @cached_property
    def inputs(self) -> tuple[np.ndarray, ...]:
        """Polynomials (s, nu) of the torques, or of the rates of velocity sources, for each interval.

        They interpolate `input_samples` over the interval's fraction; lowest power first.
        """
        plan = self.solution
        values, arrays = plan.v if self.moved_by_rates else plan.tau, plan.arrays
        points = (input_samples(arrays, number, plan.order) for number in range(plan.n_intervals))
        return tuple(lagrange_coefficients(fractions, values[rows]) for rows, fractions in points)

    @property
    def moved_by_rates(self) -> bool:
        """Whether the joints are velocity sources."""
        return self.solution.description.velocity_input

    @cached_property
    def base(self) -> Base:
        """Kind of the model's base."""
        return self.solution.base

    @cached_property
    def gravity(self) -> float:
        """Norm of gravity, m/s^2; for a model without gravity, the standard value."""
        return gravity_of(self.solution.model)

    @cached_property
    def weight(self) -> float:
        """Weight of the robot without payloads, N."""
        return mass_of(self.solution.model) * self.gravity

    @cached_property
    def reach(self) -> float:
        """Reach of the robot, m; 0 if it has none."""
        return reach(self.solution.model)

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of the robot."""
        return self.solution.units

    @cached_property
    def turning_rows(self) -> np.ndarray:
        """Which rows of v (nv,) are rotations."""
        return turning_rows(self.solution.model)

    @cached_property
    def models(self) -> dict[int, pin.Model]:
        """The model with everything that is carried, by phase."""
        plan = self.solution
        return {phase: plan.carrying_model(phase) for phase in np.unique(plan.phase).tolist()}

    @cached_property
    def masses(self) -> dict[int, float]:
        """Mass of the robot with everything that it carries, by phase, kg."""
        return {phase: mass_of(model) for phase, model in self.models.items()}

    @cached_property
    def samples(self) -> SampleQuantities:
        """Generalised forces and the motion of the contacts."""
        return sample_quantities(self.solution)

    @cached_property
    def places(self) -> ContactPlaces:
        """Placements and velocities of the contacts: a part of `samples` that is cheaper to compute."""
        return vars(self).get("samples") or contact_places(self.solution)

    @cached_property
    def surfaces(self) -> TouchedSurfaces:
        """The surfaces that contacts touch."""
        return touched_surfaces(self.solution.description, self.places.position, self.solution.phase)

    @cached_property
    def rolled_paths(self) -> RolledPaths | None:
        """Displacements by rolling of the contacts at any time; None if none rolls."""
        if self._given_paths is not None or not self.solution.description.rolling.any():
            return self._given_paths
        return RolledPaths.of(self.solution, self.places.velocity, self.surfaces)

    @cached_property
    def held_position(self) -> np.ndarray:
        """Positions (K, nc, 3) of the contacts, m, without their displacement by rolling.

        For sliding contacts, only the component along the normal.
        """
        paths, position = self.rolled_paths, self.places.position
        return held_part(position if paths is None else position - paths.at(self.solution), self.surfaces)

    @cached_property
    def held_velocity(self) -> np.ndarray:
        """Velocities (K, nc, 3) of the contacts, m/s, without rolling.

        For sliding contacts, only the component along the normal.
        """
        return held_part(without_rolling(self.places.velocity, self.surfaces), self.surfaces)

    @cached_property
    def surface_distance(self) -> np.ndarray:
        """Signed distance (K, nc) of the contacts from their surfaces, m; NaN where unknown."""
        return self.surfaces.distance(self.places.position)

    @cached_property
    def residuals(self) -> DynamicsRows:
        """Residuals of the dynamics and of the contact constraints."""
        return dynamics_rows(self.solution, self.samples, self.surfaces)

    @cached_property
    def dynamics_traces(self) -> Traces:
        """Traces of `residuals` at the collocation points."""
        return dynamics_traces(self.solution, self.residuals)

    @cached_property
    def limit_traces(self) -> Traces:
        """Traces of torques, velocities, positions and drives relative to their limits."""
        return {**limit_traces(self.solution), **drive_traces(self.solution)}

    @cached_property
    def _bodies_and_traces(self) -> tuple[FileBodies, Traces]:
        if self._given_bodies is None:
            return FileBodies.of(self.solution)
        return self._given_bodies, self._given_bodies.traces(self.solution)

    @property
    def bodies(self) -> FileBodies:
        """Bodies whose distances are measured."""
        return self._bodies_and_traces[0]

    @property
    def body_traces(self) -> Traces:
        """Traces of the depth in the ground and the distances of `bodies`."""
        return self._bodies_and_traces[1]

    @property
    def missing_shapes(self) -> tuple[str, ...]:
        """What is unknown about the motion because link shapes in its file are missing or doubtful."""
        return missing_shapes(self.solution)

    @cached_property
    def integration_gaps(self) -> IntegrationGaps:
        """Mismatch between q, v and a over an interval."""
        return interval_gaps(self.solution)

    @property
    def periodicity_error(self) -> float | None:
        """Largest difference of the last state from the image of the first; None if not periodic."""
        return periodicity_error(self.solution)

    @property
    def gimbal_margin(self) -> float | None:
        """Smallest margin of a virtual base from gimbal lock; None for other bases."""
        plan = self.solution
        return gimbal_margin_along(plan.model, plan.t, plan.q, plan.v)

    def distance_from(self, row: int, reached: np.ndarray) -> np.ndarray:
        """Return the distance (3,) of a configuration (nq,) from that of a sample, see `state_distance`."""
        return state_distance(self.solution.model, self.solution.q[row], reached)


@dataclass(frozen=True, kw_only=True)
class DynamicsRows:
    """Residuals at K samples of the rows imposed at collocation points, SI units.

    base (K, n_unactuated), actuated (K, nu): N and N m. contact (K, nc, 6), linear rows first: classical
    acceleration of the active contacts, or their velocity if joints are velocity sources, without the part
    due to rolling; zero where there is no row.
    """

    base: np.ndarray
    actuated: np.ndarray
    contact: np.ndarray


def dynamics_rows(plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces) -> DynamicsRows:
    """Return the residuals at every sample; velocity inputs have base rows RNEA(q, 0, 0) - sum J^T f."""
    free, force = plan.unactuated_rows, plan.actuation.residual_force(samples.generalized_force, plan.tau)
    balance, held = force[:, free], samples.acceleration
    if plan.description.velocity_input:  # rows of statics and of contact velocities
        still = replace(plan, v=np.zeros_like(plan.v), a=np.zeros_like(plan.a))
        balance = sample_quantities(still).generalized_force[:, free] if len(free) else balance
        held = samples.velocity
    contact = np.concatenate([held_part(without_rolling(held, surfaces), surfaces), held[..., 3:]], axis=-1)
    contact[~plan.active] = 0.0
    contact[:, ~plan.description.soles, 3:] = 0.0
    return DynamicsRows(base=balance, actuated=force[:, plan.actuated_rows], contact=contact)


def dynamics_traces(plan: Solution, rows: DynamicsRows) -> Traces:
    """Return traces of residuals at collocation points, over the weight (moments: times 1 m) and over g.

    With velocity sources, contact velocities are over sqrt(g 1 m).
    """
    points, gravity = plan.collocation[:, None], gravity_of(plan.model)
    weight = mass_of(plan.model) * gravity
    moving = np.sqrt(gravity) if plan.description.velocity_input else gravity
    names, contact = names_of_rows(plan), np.abs(rows.contact).max(axis=-1, initial=0.0) / moving
    free, actuated = ([names[i] for i in rows] for rows in (plan.unactuated_rows, plan.actuated_rows))
    return {
        "base_residual": Trace.of(np.abs(rows.base) / weight, points, free),
        "actuated_residual": Trace.of(np.abs(rows.actuated) / weight, points, actuated),
        "contact_acceleration": Trace.of(contact, points & plan.active, plan.contact_frames),
    }


# Samples closer than this fraction of the interval count as one quadrature point.
SAME_POINT = 1e-9


@dataclass(frozen=True)
class IntegrationGaps:
    """Worst mismatch of position (m, rad) and velocity (m/s, rad/s) over one interval."""

    position: float
    velocity: float


def interval_gaps(solution: Solution) -> IntegrationGaps:
    """Return the worst difference between the change over an interval and the integral of its rate.

    position: end minus start minus the integral of the velocity polynomial through all samples.
    velocity: end minus start minus the integral of the acceleration polynomial through the
    collocation points. Both vanish up to rounding for collocation of the acceleration. Schemes
    that are inconsistent within an interval (semi-implicit Euler) show their step error.
    """
    counts = np.array([len(rows) for rows in solution.intervals])
    same = (np.flatnonzero(counts == size) for size in set(counts.tolist()))
    gaps = [_intervals(solution, numbers) for numbers in same]
    return IntegrationGaps(max(gap.position for gap in gaps), max(gap.velocity for gap in gaps))


def _intervals(solution: Solution, numbers: np.ndarray) -> IntegrationGaps:
    """Return the gaps of intervals that all have the same number of samples."""
    rows = np.array([solution.intervals[number] for number in numbers])
    start, step = solution.interval_t[numbers, :1], np.diff(solution.interval_t[numbers], axis=1)
    fractions, points = (solution.t[rows] - start) / step, solution.collocation[rows]
    origin = solution.q[rows[:, :1]]
    xi, rate, second = local_state(
        solution.model, origin, solution.q[rows], solution.v[rows], solution.a[rows]
    )
    worst = np.zeros(2)
    for i, h in enumerate(step[:, 0]):
        distinct = np.concatenate([[0], 1 + np.flatnonzero(np.diff(fractions[i]) > SAME_POINT)])
        inner = points[i]
        position = xi[i, -1] - xi[i, 0] - h * quadrature_weights(fractions[i, distinct]) @ rate[i, distinct]
        velocity = rate[i, -1] - rate[i, 0] - h * quadrature_weights(fractions[i, inner]) @ second[i, inner]
        worst = np.maximum(worst, [np.abs(position).max(), np.abs(velocity).max()])
    return IntegrationGaps(*worst.tolist())


def quadrature_weights(fractions: np.ndarray) -> np.ndarray:
    """Return weights (n,) on [0, 1] that are exact for polynomials through ``fractions`` (n,)."""
    moments = 1.0 / np.arange(1, len(fractions) + 1)
    weights: np.ndarray = np.linalg.solve(np.vander(fractions, increasing=True).T, moments)
    return weights


def limit_traces(plan: Solution) -> Traces:
    """Return the excess over limits of torques, velocities and positions, and the errors of mimic joints.

    Torques and velocities are over their limits minus one, positions beyond their limits over the range.
    """
    rows = names_of_rows(plan)
    driven, least = names_of_inputs(plan), [thruster.least for thruster in plan.description.thrusters]
    # Rates that are control inputs have values only at collocation points, others everywhere.
    moving = plan.collocation[:, None] if plan.description.velocity_input else True
    lower, upper = position_limits(plan.model)
    beyond = np.maximum(plan.q - upper, lower - plan.q)
    limited = np.isfinite(lower) | np.isfinite(upper)
    span = np.where(np.isfinite(upper - lower) & (upper > lower), upper - lower, 1.0)
    places = [name for joint, name in joints_of(plan) for _ in range(joint.nq)]
    mimics = plan.description.mimics
    apart = np.zeros((plan.n_samples, len(mimics)))
    for column, mimic in enumerate(mimics):
        apart[:, column] = np.abs(mimic.apart(plan.model, plan.q))
    return {
        "effort_excess": _beyond(plan.tau, plan.description.effort_limit, driven, least=least),
        "velocity_excess": _beyond(plan.v, plan.description.velocity_limit, rows, moving),
        "position_excess": Trace.of(beyond / span, limited, places),
        "following_error": Trace.of(apart, True, [mimic.joint for mimic in mimics]),
    }


def _beyond(
    values: np.ndarray,
    limit: np.ndarray | None,
    names: list[str],
    counts: np.ndarray | bool = True,
    least: Sequence[float] = (),
) -> Trace:
    """Return |x| / limit - 1, or |x| for a limit of zero; the last columns have lower bounds ``least``."""
    bound = np.full(values.shape[1], np.inf) if limit is None else limit
    limited = np.isfinite(bound)
    unit, most = np.where(limited & (bound > 0), bound, 1.0), np.where(limited, bound, 0.0)
    beyond, last = np.where(limited, np.abs(values) - most, -np.inf), values.shape[1] - len(least)
    beyond[:, last:] = np.maximum(beyond[:, last:], least - values[:, last:])
    limited[last:] = True
    return Trace.of(beyond / unit, limited & counts, names)


def drive_traces(plan: Solution) -> Traces:
    """Return motor torque and voltage over their limits, minus one, from ``tau``, ``v`` and the drives."""
    rates, torque = plan.actuation.rates(plan.v), plan.drive_torque
    names = names_of_inputs(plan)
    current, voltage = np.zeros(torque.shape), np.zeros(torque.shape)
    limited, wound = np.zeros(torque.shape[1], dtype=bool), np.zeros(torque.shape[1], dtype=bool)
    for i, drive in enumerate(plan.drives):
        if drive is not None and np.isfinite(drive.torque_limit):
            limited[i], current[:, i] = True, torque[:, i] / drive.joint_torque_limit
        if drive is not None and np.isfinite(drive.stall_torque):
            wound[i], voltage[:, i] = True, drive.voltage_use(torque[:, i], rates[:, i])
    return {
        "drive_torque_excess": Trace.of(np.abs(current) - 1, limited, names),
        "drive_voltage_excess": Trace.of(np.abs(voltage) - 1, wound, names),
    }


@dataclass(frozen=True, kw_only=True)
class RolledPaths:
    """Displacements by rolling: polynomials of each interval's fraction, and initial values (nc, 3), m."""

    coefficients: tuple[np.ndarray, ...]
    begins: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, plan: Solution, velocity: np.ndarray, surfaces: TouchedSurfaces) -> RolledPaths:
        """Integrate omega x lever of the twists (K, nc, 6) through each interval's collocation points."""
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
        """Return the displacements (K, nc, 3) m at the samples of a plan with the same intervals."""
        begin, end = plan.interval_t[plan.interval].T
        fractions, paths = (plan.t - begin) / (end - begin), []
        for number, fraction in zip(plan.interval.tolist(), fractions, strict=True):
            powers = fraction ** np.arange(1, len(self.coefficients[number]) + 1)
            start = self.begins[number]
            paths.append(start + (powers @ self.coefficients[number]).reshape(start.shape))
        return np.array(paths)
