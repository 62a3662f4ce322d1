"""What a scene models and leaves out, by decision: whether exact or a choice, and what it saves."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

EXACT, CHOICE, KEPT, OFFER = "exact", "choice", "kept", "offer"


@dataclass(frozen=True, kw_only=True)
class ProblemSize:
    """Variables and rows of a transcription."""

    variables: int
    rows: int

    def less(self, other: ProblemSize) -> ProblemSize:
        """What the other has less than this one."""
        return ProblemSize(variables=self.variables - other.variables, rows=self.rows - other.rows)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """One decision about what a scene models.

    Args:
        kind: "exact", the optimum is the same; "choice", it may differ, by an amount to be measured; "kept",
            modelled because it is needed; "offer", could be left out on request.
        what: was left out, kept or offered.
        why: the reason.
        saved: variables and rows, 0 where the problem as built had none.
    """

    kind: str
    what: str
    why: str
    saved: ProblemSize = ProblemSize(variables=0, rows=0)


@dataclass(frozen=True, kw_only=True)
class SceneReport:
    """All decisions of one scene, the sizes before and after, and the grid these are for."""

    problem: str
    robot: str
    modelled: tuple[str, ...]
    decisions: tuple[Decision, ...]
    before: ProblemSize
    after: ProblemSize
    transcription: str
    intervals: int

    @property
    def is_exact(self) -> bool:
        """Whether the reduced problem has the same optimum, i.e. no decision was a choice."""
        return not any(decision.kind == CHOICE for decision in self.decisions)

    def of_kind(self, kind: str) -> tuple[Decision, ...]:
        """Decisions of one kind."""
        return tuple(decision for decision in self.decisions if decision.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """All of it for JSON."""
        return {**asdict(self), "exact": self.is_exact}

    def __str__(self) -> str:
        lines = [f"{self.problem} on {self.robot}: {self.transcription}, {self.intervals} intervals"]
        lines += [f"  {'' if i else 'modelled':10} {line}" for i, line in enumerate(self.modelled)]
        for kind, title in ((EXACT, "left out, exactly"), (CHOICE, "left out, a choice"), (OFFER, "offered")):
            for decision in self.of_kind(kind):
                lines += [f"  {title}: {decision.what}{_saving(decision.saved)}", f"      {decision.why}"]
        for decision in self.of_kind(KEPT):
            lines += [f"  kept: {decision.what}", f"      {decision.why}"]
        lines.append(f"  size       {_change(self.before, self.after)}")
        return "\n".join(lines)


def _saving(saved: ProblemSize) -> str:
    if not (saved.variables or saved.rows):
        return ""
    return f" (-{saved.variables} variables, -{saved.rows} rows)"


def _change(before: ProblemSize, after: ProblemSize) -> str:
    return (
        f"{before.variables} -> {after.variables} variables, {before.rows} -> {after.rows} rows"
        if before != after
        else f"{after.variables} variables, {after.rows} rows"
    )
