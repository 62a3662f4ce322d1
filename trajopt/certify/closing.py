"""Whether a periodic plan closes: its last state against the image of its first, by numeric Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.motion.cycles import periodic_image
from trajopt.solution.solution import Solution


def periodicity_error(plan: Solution) -> float | None:
    """Largest difference (m, rad, m/s, rad/s) of the last state from the first's image; None if not periodic.

    What the image is, `PeriodicImage` says.
    """
    described = plan.description.periodicity
    if not described:
        return None
    q, v = periodic_image(plan.model, described, plan.q[0], plan.v[0], float(plan.t[-1] - plan.t[0]))
    apart = pin.difference(plan.model, q, plan.q[-1])
    return float(max(np.abs(apart).max(), np.abs(v - plan.v[-1]).max()))
