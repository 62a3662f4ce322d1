"""Residuals of the dynamics and of contact motion at samples of a solution, and their figures in a check."""

from dataclasses import dataclass, replace

import numpy as np

from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.motion.samples import SampleQuantities, sample_quantities
from trajopt.motion.touched import TouchedSurfaces, held_part, without_rolling
from trajopt.motion.traces import Trace, Traces, names_of_rows
from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True)
class DynamicsRows:
    """Residuals of the rows that hold at the collocation points, at K samples, in SI units.

    base (K, n_unactuated), actuated (K, nu): N and N m. contact (K, nc, 6), linear rows first: classical
    acceleration of active contacts, with velocity sources, their velocity, of contacts that roll without what
    they roll; zero where there is no such row.
    """

    base: np.ndarray
    actuated: np.ndarray
    contact: np.ndarray


def dynamics_rows(plan: Solution, samples: SampleQuantities, surfaces: TouchedSurfaces) -> DynamicsRows:
    """Residuals at every sample; base rows of velocity sources are statics, RNEA(q, 0, 0) - sum J^T f."""
    free, force = plan.unactuated_rows, plan.actuation.unmade(samples.generalized_force, plan.tau)
    balance, held = force[:, free], samples.acceleration
    if plan.description.velocity_input:  # rows of statics and of velocities, not of motion
        still = replace(plan, v=np.zeros_like(plan.v), a=np.zeros_like(plan.a))
        balance = sample_quantities(still).generalized_force[:, free] if len(free) else balance
        held = samples.velocity
    contact = np.concatenate([held_part(without_rolling(held, surfaces), surfaces), held[..., 3:]], axis=-1)
    contact[~plan.active] = 0.0
    contact[:, ~plan.description.soles, 3:] = 0.0
    return DynamicsRows(base=balance, actuated=force[:, plan.actuated_rows], contact=contact)


def dynamics_traces(plan: Solution, rows: DynamicsRows) -> Traces:
    """Largest residuals at the collocation points, over the weight (moments: times 1 m) and over g.

    With velocity sources, the contacts' velocities are over sqrt(g 1 m).
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
