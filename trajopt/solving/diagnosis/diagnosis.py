"""A diagnosis as data, and as text for a terminal."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from trajopt.solving.diagnosis.activity import ActiveLimit
from trajopt.solving.diagnosis.conflict import Conflict
from trajopt.solving.diagnosis.contacts import PhaseContacts
from trajopt.solving.diagnosis.findings import CurvatureReport, DependentRows, RankReport
from trajopt.solving.diagnosis.nonfinite import NonFinite
from trajopt.solving.diagnosis.scaling import Scaling
from trajopt.transcription.names import BOUNDS

# Number of entries shown of long lists, which JSON has in full; width of titles in characters.
SHOWN_ENTRIES, LABEL_WIDTH = 8, 10


@dataclass(frozen=True)
class Advice:
    """A ``finding`` and its ``remedy``, in words."""

    finding: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.finding}: {self.remedy}"


@dataclass(frozen=True, kw_only=True)
class Violation:
    """A violated row or bound in words, and its violation in natural units (None if not finite)."""

    row: str
    block: str
    phase: str
    amount: float | None


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Findings at one iterate; those that need finite values are None or empty if values are not finite.

    source: what was diagnosed. status: the solver's, or None for a guess. local_error: largest error of an
    interval in m by phase, for a solved motion.
    """

    problem: str
    robot: str
    source: str
    status: str | None
    solved: bool
    variables: int
    constraints: int
    max_violation: float | None
    stationarity: float | None
    worst: tuple[Violation, ...]
    nonfinite: NonFinite | None
    ranks: tuple[RankReport, ...]
    contacts: tuple[PhaseContacts, ...]
    curvature: CurvatureReport | None
    scaling: Scaling | None
    limits: tuple[ActiveLimit, ...]
    conflict: Conflict | None
    local_error: dict[str, float] | None
    start: tuple[str, ...]
    notes: tuple[str, ...]
    advice: tuple[Advice, ...] = ()

    @property
    def clean(self) -> bool:
        """Whether there is nothing to advise."""
        return not self.advice

    @property
    def dependent(self) -> tuple[DependentRows, ...]:
        """Groups of dependent rows, first within phases, then across phases."""
        within = [group for report in self.ranks[1:] for group in report.dependent]
        known = {group.rows for group in within}
        across = [group for report in self.ranks[:1] for group in report.dependent]
        return (*within, *(group for group in across if group.rows not in known))

    @property
    def feasible(self) -> bool:
        """Whether all rows and bounds hold by the solve's criterion."""
        return self.max_violation is not None and not self.worst

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-able entries, except that numbers may be non-finite."""
        return {**asdict(self), "clean": self.clean, "feasible": self.feasible}

    def __str__(self) -> str:
        return "\n".join(_lines(self))


def _lines(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the sections in reading order: what, why, what to try."""
    state = "guess" if diagnosis.status is None else diagnosis.status.replace("_", " ")
    yield f"{diagnosis.problem} on {diagnosis.robot}: {state} ({diagnosis.source})"
    yield _line("size", f"{diagnosis.variables} variables, {diagnosis.constraints} rows")
    yield from _listed("note", diagnosis.notes)
    if diagnosis.nonfinite is not None:
        yield _line("not finite", str(diagnosis.nonfinite))
    steady = (
        "" if diagnosis.stationarity is None else f"; gradient of the Lagrangian {diagnosis.stationarity:.1e}"
    )
    yield _line("violation", f"{_amount(diagnosis.max_violation)}{steady}")
    yield from _listed("worst", (f"{one.row}: {_amount(one.amount)}" for one in diagnosis.worst))
    yield from _rank_lines(diagnosis)
    yield from _listed("contacts", (f"phase '{one.phase}': {one}" for one in diagnosis.contacts))
    if diagnosis.curvature is not None:
        yield _line("curvature", str(diagnosis.curvature))
        flat = diagnosis.curvature.flat_along
        along = (*diagnosis.curvature.smallest_along, *(one for one in flat if diagnosis.curvature.negative))
        yield from _listed("", map(str, along))
    yield from _scaling_lines(diagnosis)
    yield from _limit_lines(diagnosis)
    if diagnosis.conflict is not None:
        yield from _conflict_lines(diagnosis.conflict)
    if diagnosis.local_error:
        worst = ", ".join(f"'{name}' {error:.1e} m" for name, error in diagnosis.local_error.items())
        yield _line("intervals", f"largest error of one interval, from its own start: {worst}")
    yield from _listed("start", diagnosis.start)
    yield from _listed("try", map(str, diagnosis.advice), limit=None)
    if diagnosis.clean:
        yield _line("try", "nothing: rows are independent, curved and scaled as they should be")


def _line(title: str, text: str) -> str:
    return f"  {title:{LABEL_WIDTH}} {text}"


def _listed(title: str, entries: Iterable[str], limit: int | None = SHOWN_ENTRIES) -> Iterator[str]:
    every = list(entries)
    shown = every if limit is None else every[:limit]
    for index, entry in enumerate(shown):
        yield _line("" if index else title, entry)
    if len(every) > len(shown):
        yield _line("", f"and {len(every) - len(shown)} more (`to_dict()` has all)")


def _amount(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.2e}"


def _rank_lines(diagnosis: Diagnosis) -> Iterator[str]:
    texts = []
    for report in diagnosis.ranks:
        texts.append(f"{'all' if report.phase is None else repr(report.phase)}: {report}")
        known = {group.rows for one in diagnosis.ranks[1:] for group in one.dependent}
        fresh = [g for g in report.dependent if report.phase is not None or g.rows not in known]
        texts += [f"  {group}" for group in fresh[:SHOWN_ENTRIES]]
        if len(fresh) > SHOWN_ENTRIES:
            texts.append(f"  and {len(fresh) - SHOWN_ENTRIES} more groups (`to_dict()` has all)")
    yield from _listed("rank", texts, limit=None)


def _scaling_lines(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.scaling is None:
        return
    scale = diagnosis.scaling
    yield _line("scaling", f"Jacobian {scale.jacobian}, Hessian {scale.hessian}, gradient {scale.gradient}")
    for block in scale.blocks[:3]:
        paid = "" if block.multiplier is None else f", multipliers {block.multiplier}"
        yield _line("", f"{block.block}: {block.rows} rows, norms {block.row_norm}{paid}")
    for kind in scale.kinds[:2]:
        yield _line("", f"{kind.kind}: values {kind.value}, columns {kind.column_norm}")


def _limit_lines(diagnosis: Diagnosis) -> Iterator[str]:
    if not diagnosis.scaling:
        return
    blocks = Counter(limit.block for limit in diagnosis.limits)
    counts = ", ".join(f"{name if name != BOUNDS else 'bounds of nodes'} {n}" for name, n in blocks.items())
    yield _line("limits", f"active: {counts}" if counts else "none is active")
    yield from _listed("", map(str, diagnosis.limits))


def _conflict_lines(clash: Conflict) -> Iterator[str]:
    least = f"linearised, at least {clash.after:.2e} within a natural unit"
    yield _line("conflict", f"rows miss {clash.before:.2e} in sum; {least}")
    yield from _listed("  gives", map(str, clash.giving))
    yield from _listed("  against", map(str, clash.against))
