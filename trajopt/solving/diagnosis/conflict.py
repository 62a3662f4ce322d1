"""Which rows contradict each other: the elastic minimum of the linearised constraints.

About an iterate, within a box in natural units, it minimises the sum of violations of the linearised rows,

    min sum w (s+ + s-)    lower <= g + J p + s+ - s- <= upper,    |p| <= box,  bounds of variables

The weight w is 1, and large for the motion itself (defects and dynamics), so that goals and limits are
relaxed first. Rows with s > 0 must give way. The multipliers y, with magnitudes up to w, are a Farkas
certificate: rows weighted by y add up to a contradiction, so rows and bounds with large multipliers conflict
with those that give way. (Gill, Murray, Saunders, "SNOPT", SIAM Review 2005, elastic mode.)
"""

from dataclasses import dataclass

import numpy as np
import piqp  # type: ignore[import-untyped]
from scipy import sparse

from trajopt.solving.conflict import ConflictMember, members_against, members_giving, rows_of_motion
from trajopt.solving.diagnosis.snapshot import Snapshot

# Largest change of variables, scaled units: the range in which the linearisation is trusted.
BOX = 1.0
# Weight of the step: it selects the nearest of several minima and makes the program well-posed.
STEP_WEIGHT = 1e-6
# Violations below this fraction of the largest one are ignored.
LEAST_SHARE = 1e-3
# Weight of rows of the dynamics, which makes them give way last.
DYNAMICS_WEIGHT = 1e3
# Fraction of the violation left after the best small step: above the first, a conflict; below the second, an
# early iterate.
CONFLICT_SHARE, EARLY_SHARE = 0.5, 0.01


@dataclass(frozen=True, kw_only=True)
class Conflict:
    """A conflict between constraints.

    before, after: sum of violations at the iterate, and its least value within the box.
    giving: rows that must give way. against: limits, bounds and goals that conflict with them.
    edge: fraction of the variables at the edge of the box.
    """

    before: float
    after: float
    giving: tuple[ConflictMember, ...]
    against: tuple[ConflictMember, ...]
    edge: float

    @property
    def is_conflict(self) -> bool:
        """Whether no small step removes half of the violation: a conflict rather than an early iterate."""
        return self.after > CONFLICT_SHARE * self.before

    @property
    def is_early(self) -> bool:
        """Whether a small step removes nearly all of the violation: an early iterate."""
        return self.after <= EARLY_SHARE * self.before


def conflict(snapshot: Snapshot) -> Conflict | None:
    """Return the conflict at an iterate, or None if the quadratic program cannot be solved."""
    t = snapshot.transcription
    free = np.flatnonzero(~snapshot.fixed)
    jacobian = snapshot.jacobian[:, free].tocsc()
    m, n = jacobian.shape
    result = _elastic(snapshot, jacobian, free)
    if result is None:
        return None
    x, weights = result
    step, give = x[:n], x[n : n + m] + x[n + m :]
    before = float(snapshot.violations[: t.n_rows].sum())
    give[give < LEAST_SHARE * max(give.max(initial=0.0), snapshot.tolerance)] = 0.0
    return Conflict(
        before=before,
        after=float(give.sum()),
        giving=members_giving(snapshot.names, give),
        against=members_against(snapshot.names, give, weights),
        edge=float(np.mean(np.abs(step) > 0.99 * BOX)),
    )


def _elastic(
    snapshot: Snapshot, jacobian: sparse.csc_matrix, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Solve the elastic program; return its variables and the multipliers of rows and of true bounds."""
    t = snapshot.transcription
    m, n = jacobian.shape
    eye = sparse.eye(m, format="csc")
    rows = sparse.hstack([jacobian, eye, -eye], format="csc")
    equal = snapshot.equality
    lower_room, upper_room = (t.lower_x - snapshot.x)[free], (t.upper_x - snapshot.x)[free]
    low = np.concatenate([np.clip(lower_room, -BOX, 0.0), np.zeros(2 * m)])
    high = np.concatenate([np.clip(upper_room, 0.0, BOX), np.full(2 * m, np.inf)])
    price = np.full(n + 2 * m, STEP_WEIGHT)
    elastic = np.where(rows_of_motion(t), DYNAMICS_WEIGHT, 1.0)
    solver = piqp.SparseSolver()
    solver.settings.verbose = False
    solver.settings.eps_abs, solver.settings.eps_rel, solver.settings.max_iter = 1e-7, 1e-8, 100
    solver.setup(
        sparse.diags(price, format="csc"),
        np.concatenate([np.zeros(n), elastic, elastic]),
        rows[equal].tocsc(),
        (t.lower_g - snapshot.g)[equal],
        rows[~equal].tocsc(),
        (t.lower_g - snapshot.g)[~equal],
        (t.upper_g - snapshot.g)[~equal],
        low,
        high,
    )
    status = solver.solve()
    if status not in (piqp.PIQP_SOLVED, piqp.PIQP_MAX_ITER_REACHED):
        return None
    result = solver.result
    weights = np.zeros(len(snapshot.lower))
    weights[np.flatnonzero(equal)] = result.y
    weights[np.flatnonzero(~equal)] = result.z_u - result.z_l
    weights[m + free] = result.z_bu[:n] * (upper_room < BOX) - result.z_bl[:n] * (lower_room > -BOX)
    return np.array(result.x), weights
