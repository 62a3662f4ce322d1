"""All quantities along a motion by numeric Pinocchio, each computed when it is first asked for."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import Base, base_of
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.dynamics.virtual_base import gimbal_margin_along
from trajopt.motion.body_distances import FileBodies, missing_shapes
from trajopt.motion.carried import carrying_model
from trajopt.motion.cycles import periodicity_error
from trajopt.motion.dynamics_rows import DynamicsRows, dynamics_rows, dynamics_traces
from trajopt.motion.integration_gaps import IntegrationGaps, interval_gaps
from trajopt.motion.limits import drive_traces, limit_traces
from trajopt.motion.resampling import samples_at
from trajopt.motion.rolled import RolledPaths
from trajopt.motion.samples import (
    ContactPlaces,
    SampleQuantities,
    contact_places,
    sample_quantities,
    state_distance,
)
from trajopt.motion.touched import TouchedSurfaces, held_part, touched_surfaces, without_rolling
from trajopt.motion.traces import Traces
from trajopt.robot.building import reach
from trajopt.robot.natural_units import NaturalUnits, turning_rows
from trajopt.solution.interpolation import (
    InterpolatedMotion,
    collocation_fractions,
    lagrange_coefficients,
)
from trajopt.solution.solution import Solution


class MotionQuantities:
    """Quantities along a solution with K samples, I intervals and nc contacts, SI units.

    Args:
        solution: the motion, with rotations of unit norm.
        bodies: those whose distances are measured; default: those of the solution.
        rolled: how far contacts have rolled; default: by the solution's velocities.
    """

    def __init__(
        self, solution: Solution, bodies: FileBodies | None = None, rolled: RolledPaths | None = None
    ) -> None:
        self.solution = solution
        self._given_bodies, self._given_paths = bodies, rolled

    @classmethod
    def normalized(cls, solution: Solution) -> MotionQuantities:
        """Quantities of a solution whose rotations may be of another norm."""
        return cls(solution.normalized())

    def between(self, numbers: np.ndarray, fractions: np.ndarray) -> MotionQuantities:
        """The same motion with samples at fractions (n,) of intervals (n,), see `samples_at`."""
        samples = self.polynomials.at(numbers, fractions)
        solution = samples_at(self.solution, numbers, fractions, samples)
        return MotionQuantities(solution, self.bodies, self.rolled_paths)

    @property
    def polynomials(self) -> InterpolatedMotion:
        """The motion at any time."""
        return self.solution.polynomials

    @cached_property
    def inputs(self) -> tuple[np.ndarray, ...]:
        """Polynomials (s, nu) over each interval's fraction of its torques, or rates of velocity sources.

        Coefficients, lowest power first, through the collocation points.
        """
        plan = self.solution
        values, arrays = plan.v if self.moved_by_rates else plan.tau, plan.arrays
        points = (collocation_fractions(arrays, number) for number in range(plan.n_intervals))
        return tuple(lagrange_coefficients(fractions, values[rows]) for rows, fractions in points)

    @property
    def moved_by_rates(self) -> bool:
        """Whether the joints are velocity sources."""
        return self.solution.description.velocity_input

    @cached_property
    def base(self) -> Base:
        """Kind of the model's base."""
        return base_of(self.solution.model)

    @cached_property
    def gravity(self) -> float:
        """Norm of gravity, m/s^2; of a model without, that of the earth."""
        return gravity_of(self.solution.model)

    @cached_property
    def weight(self) -> float:
        """Weight of the robot without what it carries, N."""
        return mass_of(self.solution.model) * self.gravity

    @cached_property
    def reach(self) -> float:
        """Reach of the robot, m; 0 where it has none."""
        return reach(self.solution.model)

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of the robot."""
        return NaturalUnits.of(self.solution.model)

    @cached_property
    def turning_rows(self) -> np.ndarray:
        """Which rows of v (nv,) are rotations."""
        return turning_rows(self.solution.model)

    @cached_property
    def models(self) -> dict[int, pin.Model]:
        """By phase, the model with everything that is carried in it."""
        plan = self.solution
        return {phase: carrying_model(plan, phase) for phase in np.unique(plan.phase).tolist()}

    @cached_property
    def masses(self) -> dict[int, float]:
        """By phase, the mass of the robot with everything that it carries, kg."""
        return {phase: mass_of(model) for phase, model in self.models.items()}

    @cached_property
    def samples(self) -> SampleQuantities:
        """Generalised forces and the motion of the contacts."""
        return sample_quantities(self.solution)

    @cached_property
    def places(self) -> ContactPlaces:
        """Placements and velocities of the contacts: part of `samples`, at a fraction of its time."""
        return vars(self).get("samples") or contact_places(self.solution)

    @cached_property
    def surfaces(self) -> TouchedSurfaces:
        """What contacts touch."""
        return touched_surfaces(self.solution, self.places.position)

    @cached_property
    def rolled_paths(self) -> RolledPaths | None:
        """How far contacts have rolled at any time; None where none rolls."""
        if self._given_paths is not None or not self.solution.description.rolling.any():
            return self._given_paths
        return RolledPaths.of(self.solution, self.places.velocity, self.surfaces)

    @cached_property
    def held_position(self) -> np.ndarray:
        """Positions (K, nc, 3) of the contacts, m, without what they have rolled.

        Of sliding ones only along the normal.
        """
        paths, position = self.rolled_paths, self.places.position
        return held_part(position if paths is None else position - paths.at(self.solution), self.surfaces)

    @cached_property
    def held_velocity(self) -> np.ndarray:
        """Velocities (K, nc, 3) of the contacts, m/s, without what they roll.

        Of sliding ones only along the normal.
        """
        return held_part(without_rolling(self.places.velocity, self.surfaces), self.surfaces)

    @cached_property
    def surface_distance(self) -> np.ndarray:
        """Signed distance (K, nc) of the contacts from what they touch, m; NaN where that is not known."""
        return self.surfaces.distance(self.places.position)

    @cached_property
    def residuals(self) -> DynamicsRows:
        """Residuals of the dynamics and of the motion of contacts."""
        return dynamics_rows(self.solution, self.samples, self.surfaces)

    @cached_property
    def dynamics_traces(self) -> Traces:
        """Figures of `residuals` at the collocation points."""
        return dynamics_traces(self.solution, self.residuals)

    @cached_property
    def limit_traces(self) -> Traces:
        """Figures of torques, velocities, positions and drives against their limits."""
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
        """Depth in the ground, and distances, of `bodies`."""
        return self._bodies_and_traces[1]

    @property
    def missing_shapes(self) -> tuple[str, ...]:
        """What is not known of the motion because its file lacks shapes of links."""
        return missing_shapes(self.solution)

    @cached_property
    def integration_gaps(self) -> IntegrationGaps:
        """Whether q, v and a belong to one motion."""
        return interval_gaps(self.solution)

    @property
    def periodicity_error(self) -> float | None:
        """Difference of the last state from the image of the first; None if the motion is not periodic."""
        return periodicity_error(self.solution)

    @property
    def gimbal_margin(self) -> float | None:
        """Least margin of a virtual base from gimbal lock; None for other bases."""
        plan = self.solution
        return gimbal_margin_along(plan.model, plan.t, plan.q, plan.v)

    def distance_from(self, row: int, reached: np.ndarray) -> np.ndarray:
        """Distance (3,) of a configuration (nq,) from that of a sample, see `state_distance`."""
        return state_distance(self.solution.model, self.solution.q[row], reached)
