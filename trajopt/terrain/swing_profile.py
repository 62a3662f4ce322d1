"""Profiles over the course of a swing: the least height as a fraction of the clearance, and a smooth step."""

from __future__ import annotations

from trajopt.errors import require_not_negative


def require_clearance(clearance: float) -> None:
    """Raise `InputError` for a swing clearance, m, that is negative or not finite."""
    require_not_negative("swing clearance", clearance, "m")


def swing_profile(s: float) -> float:
    """16 s^2 (1 - s)^2 at the fraction ``s`` of a swing: one in mid swing, zero and flat at its ends.

    Flat, because a foot begins and ends its swing at rest: with a profile of finite slope there, such as
    4 s (1 - s), the height at the first node after lift-off is proportional to the step, and the acceleration
    needed is inversely proportional to it: the optimum would have no limit as the mesh is refined.
    """
    return 16.0 * s * s * (1.0 - s) ** 2


def smooth_step(s: float) -> float:
    """From 0 to 1 with rate and acceleration zero at both ends: 10 s^3 - 15 s^4 + 6 s^5, clipped."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)
