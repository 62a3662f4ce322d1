"""How high a swing is asked to be, as a part of its clearance, over the course of the swing."""

from __future__ import annotations


def swing_profile(s: float) -> float:
    """16 s^2 (1 - s)^2 at the part ``s`` of a swing: one in mid swing, zero and flat at its ends.

    Flat, because a foot begins and ends its swing at rest: a profile that rises at once, such as 4 s (1 - s),
    asks at the first node after the lift-off for a height in proportion to the step, which takes an
    acceleration in inverse proportion to it, so that the optimum has no limit as meshes get finer.
    """
    return 16.0 * s * s * (1.0 - s) ** 2


def smooth_step(s: float) -> float:
    """From 0 to 1 with rate and acceleration zero at both ends: 10 s^3 - 15 s^4 + 6 s^5, clipped."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)
