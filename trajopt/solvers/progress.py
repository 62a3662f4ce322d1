"""Test whether a solve makes progress, from the figures of its iterations.

If rows contradict each other, an interior-point method stalls: its multipliers, and with them the dual
infeasibility, grow without bound while the rows stay violated. Measured with IPOPT on first meshes: 64 of 65
successful solves stay below 3e3 while rows are violated, and one below 1e5; ten that cannot succeed exceed
1e4 within 4 to 21 iterations, and 1e6 within 34.
"""

from collections.abc import Sequence

# Rows violated by less than this, scaled units, count as feasible.
VIOLATED = 1e-3
# A solve is tested after more than LEAST iterations; all of the LAST ones must have large multipliers.
LEAST, LAST = 8, 3
# Dual infeasibility of multipliers that grow without bound.
LARGE = 1e4
# The violation, or the dual infeasibility, must fall by this factor within this many iterations.
FACTOR, WITHIN = 0.5, 20


def is_stalled(primal: Sequence[float], dual: Sequence[float]) -> bool:
    """Return whether a solve seems to stall, from its primal and dual infeasibility at each iteration.

    Pass an infinite dual infeasibility for iterations of the restoration phase, which have none.
    """
    if len(primal) <= LEAST or min(primal) <= VIOLATED:
        return False
    creeps = min(dual[-LAST:]) > LARGE
    return creeps or (_stays(primal) and _stays(dual))


def _stays(figures: Sequence[float]) -> bool:
    """Return whether the last figures are hardly below the best one before them."""
    return len(figures) > WITHIN and min(figures[-WITHIN:]) > FACTOR * min(figures[:-WITHIN])
