"""Findings on rank, curvature and the start, with names instead of indices."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.solving.diagnosis.curvature import curvature
from trajopt.solving.diagnosis.rank import dependencies, spectrum
from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.terms.limits import PositionLimits

# Numbers of rows of a dependent group, of variables of a direction, and of directions to name.
NAMED_ROWS, NAMED_UNKNOWNS, NAMED_DIRECTIONS = 8, 3, 4
# Positions this close to a limit (rad, m) are on it.
ON_LIMIT = 1e-9


@dataclass(frozen=True, kw_only=True)
class DependentRows:
    """Rows that depend on each other, found ``times`` times between the places first and last.

    rows: rows in words, largest share first. blocks: their blocks. more: number of further rows.
    excess: total number of redundant rows. fixed: whether they depend only on fixed variables.
    equations: whether none of them is an active limit.
    """

    rows: tuple[str, ...]
    blocks: tuple[str, ...]
    more: int
    excess: int
    times: int
    first: str
    last: str
    fixed: bool
    equations: bool

    def __str__(self) -> str:
        more = f" and {self.more} more" if self.more else ""
        where = self.first if self.first == self.last else f"{self.first}, to {self.last}"
        where = where if self.times == 1 else f"{self.times} times, {where}"
        why = "depend on fixed variables alone" if self.fixed else "depend on each other"
        return f"{', '.join(self.rows)}{more} {why} ({self.excess} too many): {where}"


@dataclass(frozen=True, kw_only=True)
class RankReport:
    """Rank of the active rows over the free variables in them, for one phase, or all if ``phase`` is None.

    equations: limits are left out because the iterate is far from feasible. nullity: number of redundant
    rows, or a lower bound of it unless ``complete``. condition: largest over smallest nonzero singular value,
    None without any. dependent: groups of rows that depend on each other.
    """

    phase: str | None
    equations: bool
    rows: int
    unknowns: int
    rank: int
    nullity: int
    complete: bool
    smallest: float | None
    largest: float
    condition: float | None
    dependent: tuple[DependentRows, ...]

    @property
    def full(self) -> bool:
        """Whether all rows are independent."""
        return self.nullity == 0

    def __str__(self) -> str:
        least = "" if self.complete else "at most "
        kind = "equations" if self.equations else "active rows"
        text = f"{self.rows} {kind} over {self.unknowns} free variables, rank {least}{self.rank}"
        return text if self.condition is None else f"{text}, condition {self.condition:.1e}"


def rank_report(snapshot: Snapshot, phase: int | None) -> RankReport:
    """Return the rank of the active rows of a phase, or of all; active bounds fix their variables.

    Rows of a phase are those of its intervals and nodes, with the defects that lead out of it, over all free
    variables in them. Dependence across phases shows only in the report on all rows.
    """
    names, rows = snapshot.names, snapshot.active_rows
    if phase is not None:
        stages = snapshot.transcription.rows.stage[rows].tolist()
        rows = rows[[names.phase_index(stage) == phase for stage in stages]]
    matrix = snapshot.jacobian[rows][:, snapshot.free].tocsr()
    matrix.eliminate_zeros()
    touched = np.unique(matrix.indices)
    matrix = matrix[:, touched]
    seeing = np.diff(matrix.indptr) > 0
    blind, seen = rows[~seeing], rows[seeing]
    result = spectrum(matrix[seeing])
    groups = [(seen[group.rows], group.excess) for group in dependencies(result.vectors)]
    merged = _merged(snapshot, groups, fixed=False)
    merged += _merged(snapshot, [(np.array([row]), 1) for row in blind], fixed=True)
    return RankReport(
        phase=None if phase is None else names.layout.schedule.phases[phase].name,
        equations=snapshot.equations_only,
        rows=len(rows),
        unknowns=len(touched),
        rank=result.rank,
        nullity=result.nullity + len(blind),
        complete=result.complete,
        smallest=result.smallest,
        largest=result.largest,
        condition=result.condition,
        dependent=tuple(merged),
    )


def _merged(snapshot: Snapshot, groups: list[tuple[np.ndarray, int]], *, fixed: bool) -> list[DependentRows]:
    """Merge groups (rows, number of redundant rows) that have the same rows at different places."""
    names = snapshot.names
    kinds: defaultdict[tuple[str, ...], list[tuple[np.ndarray, int]]] = defaultdict(list)
    for rows, excess in groups:
        what = sorted({names.row(int(row)).what for row in rows})
        kinds[*what, names.phase(names.sites[int(rows[0])].stage)].append((rows, excess))
    merged = []
    for same in kinds.values():
        rows, _ = same[0]
        subjects = list(dict.fromkeys(names.row(int(row)).what for row in rows))
        sites = sorted({names.sites[int(row)] for members, _ in same for row in members})
        merged.append(
            DependentRows(
                rows=tuple(subjects[:NAMED_ROWS]),
                blocks=tuple(dict.fromkeys(names.block(int(row)) for row in rows)),
                more=max(0, len(subjects) - NAMED_ROWS),
                excess=sum(excess for _, excess in same),
                times=len(same),
                first=names.place(sites[0]),
                last=names.place(sites[-1]),
                fixed=fixed,
                equations=bool(snapshot.equality[np.concatenate([members for members, _ in same])].all()),
            )
        )
    return sorted(merged, key=lambda one: -one.excess)


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A free direction: its curvature, its largest variables with their share, and its main place."""

    curvature: float
    unknowns: tuple[str, ...]
    kinds: tuple[str, ...]
    place: str

    def __str__(self) -> str:
        return f"{self.curvature:.1e} along {', '.join(self.unknowns)}, most at {self.place}"


@dataclass(frozen=True, kw_only=True)
class CurvatureReport:
    """Curvature of the Lagrangian on the null space of the active rows, with named directions.

    For the numbers see `Curvature`. known: whether there were multipliers. smallest_along: directions of the
    smallest curvature. flat_along: some of the directions without curvature.
    """

    directions: int
    smallest: float | None
    largest: float | None
    flat: float
    holds: bool
    negative: bool
    exact: bool
    known: bool
    smallest_along: tuple[Direction, ...]
    flat_along: tuple[Direction, ...]

    def __str__(self) -> str:
        if self.smallest is None or self.largest is None:
            return "no free direction: active rows determine the iterate"
        verdict = "holds" if self.holds else "does NOT hold" if self.negative else "holds weakly"
        how = "" if self.exact else " (by Lanczos)"
        whose = "" if self.known else ", of the objective alone"
        return (
            f"{self.smallest:.2e} to {self.largest:.2e} over {self.directions} free directions{how}{whose}; "
            f"the second-order condition {verdict}"
        )


def curvature_report(snapshot: Snapshot) -> CurvatureReport:
    """Return the curvature on the null space of the active rows, and name the flattest directions."""
    free, rows = snapshot.free, snapshot.active_rows
    result = curvature(snapshot.hessian[free][:, free], snapshot.jacobian[rows][:, free])
    named = range(result.vectors.shape[1])
    nearest = np.argsort(np.abs(result.values[named]), kind="stable")[:NAMED_DIRECTIONS]

    def along(which: Iterable[int]) -> tuple[Direction, ...]:
        return tuple(_direction(snapshot, float(result.values[i]), result.vectors[:, i]) for i in which)

    shared = ("directions", "smallest", "largest", "flat", "holds", "negative", "exact")
    return CurvatureReport(
        **{name: getattr(result, name) for name in shared},
        known=snapshot.row_multiplier is not None,
        smallest_along=along(named[:NAMED_DIRECTIONS]),
        flat_along=along(nearest[np.abs(result.values[nearest]) <= result.flat]),
    )


def _direction(snapshot: Snapshot, value: float, vector: np.ndarray) -> Direction:
    """Describe a direction by the share of each variable in its squared length, summed over time."""
    names, free = snapshot.names, snapshot.free
    share: defaultdict[str, float] = defaultdict(float)
    kinds: defaultdict[str, float] = defaultdict(float)
    for index, part in zip(free.tolist(), (vector**2).tolist(), strict=True):
        label = names.unknown_labels[index]
        share[str(label)] += part
        kinds[label.kind] += part
    largest = sorted(share, key=lambda name: -share[name])[:NAMED_UNKNOWNS]
    most = int(free[int(np.argmax(np.abs(vector)))])
    return Direction(
        curvature=value,
        unknowns=tuple(f"{name} ({share[name]:.0%})" for name in largest),
        kinds=tuple(sorted(kinds, key=lambda kind: -kinds[kind])[:NAMED_UNKNOWNS]),
        place=names.place(names.unknown_sites[most]),
    )


def start_findings(problem: Problem) -> Iterator[str]:
    """Yield joints whose start is outside their limits, or exactly on one, which is degenerate."""
    if problem.periodicity is not None or not any(isinstance(t, PositionLimits) for t in problem.terms):
        return
    robot, q = problem.robot, problem.initial_q
    for name, joint in zip(list(robot.model.names)[1:], list(robot.model.joints)[1:], strict=True):
        entries = slice(joint.idx_q, joint.idx_q + joint.nq)
        if joint.nq != 1:
            continue
        low, value, high = robot.position_lower[entries][0], q[entries][0], robot.position_upper[entries][0]
        for bound, beyond, side in ((low, low - value, "lower"), (high, value - high, "upper")):
            if beyond > ON_LIMIT:
                yield f"the start has {name} at {value:.4g}, beyond its {side} limit {bound:.4g}"
            elif abs(beyond) <= ON_LIMIT:
                yield f"the start has {name} exactly on its {side} limit {bound:.4g}"
