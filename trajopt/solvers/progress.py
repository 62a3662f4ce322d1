"""Whether a solve makes progress: a test of the figures of its iterations.

Where rows contradict each other, an interior-point method creeps: its multipliers, and with them the dual
infeasibility, grow without bound while the rows stay violated. Measured with IPOPT on first meshes: 64 of 65
solves that succeed stay below 3e3 as long as rows are violated, one below 1e5; ten that cannot succeed pass
1e4 within 4 to 21 iterations, and 1e6 within 34.
"""

from collections.abc import Sequence

# Rows violated by less than this, scaled units, count as feasible.
VIOLATED = 1e-3
# No verdict on fewer iterations; so many of the last ones must have large multipliers.
LEAST, LAST = 8, 3
# Dual infeasibility of multipliers that grow without bound.
LARGE = 1e4
# The violation, or the dual infeasibility, must fall by this factor within so many iterations.
FACTOR, WITHIN = 0.5, 20


def is_stalled(primal: Sequence[float], dual: Sequence[float]) -> bool:
    """Whether a solve seems to get nowhere, from its primal and dual infeasibility at every iteration.

    Iterations of a restoration have none of the problem: they count as infinite.
    """
    if len(primal) <= LEAST or min(primal) <= VIOLATED:
        return False
    creeps = min(dual[-LAST:]) > LARGE
    return creeps or (_stays(primal) and _stays(dual))


def _stays(figures: Sequence[float]) -> bool:
    """Whether the last figures fall little below the best before them."""
    return len(figures) > WITHIN and min(figures[-WITHIN:]) > FACTOR * min(figures[:-WITHIN])
