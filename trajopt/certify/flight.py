"""Free motion in flight: the centre of mass follows a parabola, and angular momentum is constant."""

import numpy as np
import pinocchio as pin

from trajopt.motion.quantities import MotionQuantities
from trajopt.solution.solution import Solution

# Smallest scale of angular momentum, as a fraction of m l sqrt(g l) for a robot of mass m and reach l.
QUIET_MOMENTUM = 1e-2
# Smallest travel of the centre of mass (m) that ballistic errors are relative to.
LEAST_TRAVEL = 1e-6


FIGURES = ("ballistic_error", "momentum_error", "ballistic_error_between", "momentum_error_between")


def flight_errors(motion: MotionQuantities, phase: range) -> dict[str, float | None]:
    """Return the ``FIGURES`` of free motion in ``phase``; None with contacts, thrusters or a fixed base.

    Ballistic: max |c - c_0 - c'_0 t - g t^2 / 2| over the phase's max |c - c_0|.
    Momentum: max |h - h_0| over max(|h|, ``QUIET_MOMENTUM`` m l sqrt(g l)), with h the angular momentum about
    the centre of mass and l the reach. For a planar base only the free components count. Both are given at
    nodes, where a scheme has its full order, and at the collocation points between them.
    """
    solution, base = motion.solution, motion.base
    samples = slice(phase.start, phase.stop)
    if base == "fixed" or solution.description.thrusters or solution.active[samples].any():
        return dict.fromkeys(FIGURES)
    t = solution.t[samples] - solution.t[phase.start]
    com, velocity, momentum, mass = _centroidal(solution, phase)
    gravity = np.asarray(solution.model.gravity.linear)
    deviation = com - com[0] - np.outer(t, velocity[0]) - 0.5 * np.outer(t**2, gravity)
    if base == "planar":
        axes = solution.model.jointPlacements[1].rotation
        deviation, momentum = deviation @ axes[:, :2], momentum @ axes[:, 2:]
    travel = max(float(np.linalg.norm(com - com[0], axis=1).max()), LEAST_TRAVEL)
    length, fall = motion.reach, float(np.linalg.norm(gravity)) or 1.0
    quiet = QUIET_MOMENTUM * mass * length * np.sqrt(fall * length)
    scale = max(float(np.linalg.norm(momentum, axis=1).max()), quiet)
    ballistic = np.linalg.norm(deviation, axis=1) / travel
    change = np.linalg.norm(momentum - momentum[0], axis=1) / scale
    node = ~solution.collocation[samples]
    errors = (part[at].max() for at in (node, ~node) for part in (ballistic, change))
    return dict(zip(FIGURES, map(float, errors), strict=True))


def _centroidal(solution: Solution, phase: range) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the centre of mass (n, 3), its velocity (n, 3), angular momentum about it (n, 3), mass (kg)."""
    model = solution.model
    data = model.createData()
    com, velocity, momentum = [], [], []
    for row in phase:
        total = pin.computeCentroidalMomentum(model, data, solution.q[row], solution.v[row])
        mass = pin.computeTotalMass(model, data)
        com.append(pin.centerOfMass(model, data, solution.q[row]).copy())
        velocity.append(total.linear / mass)
        momentum.append(total.angular.copy())
    return np.array(com), np.array(velocity), np.array(momentum), float(mass)
