"""Energy drawn by the drives of a solution, and its cost of transport."""

import math
from typing import Annotated

import numpy as np
import pinocchio as pin

from trajopt.arguments import SignedFraction, checked
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.kinds import ArrayShape
from trajopt.motion.grid import interval_schemes
from trajopt.motion.solution import Solution
from trajopt.terms.drives import heat_coefficients


@checked
def energy(solution: Solution, *, recovered: SignedFraction = -1.0) -> float:
    """Return the energy in J that the drives draw: the integral of `power` by the scheme's quadrature.

    It uses the torques, rates and drives of the solution at its collocation points.

    Args:
        solution: The motion.
        recovered: Fraction of negative mechanical power that is recovered, -1 to 1.

    Raises:
        InputError: If ``recovered`` is outside that range.
    """
    torque = solution.drive_torque
    power = torque * solution.actuation.rates(solution.v)
    drawn = (1 + recovered) / 2 * power + (1 - recovered) / 2 * np.abs(power)
    heat = torque**2 * heat_coefficients(solution.drives, solution.tau.shape[1])
    return integral(solution, (drawn + heat).sum(axis=1))


@checked
def integral(solution: Solution, values: Annotated[np.ndarray, ArrayShape((None,))]) -> float:
    """Integrate values (K,) at the samples over time by the quadrature of the transcription."""
    return float(np.dot(_quadrature(solution), values))


def _quadrature(solution: Solution) -> np.ndarray:
    """Return the weight of every sample (K,), s, which is zero except at collocation points."""
    weights = np.zeros(solution.n_samples)
    schemes = interval_schemes(solution)
    for rows, (start, end), method in zip(solution.intervals, solution.interval_t, schemes, strict=True):
        weights[[row for row in rows if solution.collocation[row]]] = method.b1 * (end - start)
    return weights


@checked
def cost_of_transport(solution: Solution, *, recovered: SignedFraction = -1.0) -> float:
    """Return energy over weight times horizontal displacement of the centre of mass, dimensionless.

    The displacement is the straight line from the first sample to the last. The result is infinite without
    displacement or contacts, and for a fully actuated robot, such as one with a fixed base.

    Args:
        solution: The motion.
        recovered: See `energy`.
    """
    model = solution.model
    if not (solution.n_unactuated and solution.contact_frames):
        return math.inf
    start, end = (pin.centerOfMass(model, model.createData(), solution.q[row]).copy() for row in (0, -1))
    upwards = -model.gravity.linear / (np.linalg.norm(model.gravity.linear) or 1.0)
    way = end - start
    distance = float(np.linalg.norm(way - upwards * (upwards @ way)))
    used = energy(solution, recovered=recovered)
    weight = mass_of(model) * gravity_of(model)
    return used / (weight * distance) if distance > 0 else math.inf
