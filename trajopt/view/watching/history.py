"""History of a solve: the figures of every iteration, and which solve it is."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from trajopt.solving.monitoring import Iterate

FIGURES = (
    "objective",
    "primal",
    "dual",
    "barrier",
    "step",
    "regularization",
    "line_search",
    "restoration",
)
# Trials of a line search from which it is reported: the step is a sixteenth of the first, or less.
MANY_TRIALS = 5
# A step below this fraction of the full step makes hardly any progress.
SHORT_STEP = 1e-3


@dataclass(kw_only=True, eq=False)
class History:
    """Figures of the present solve, one entry an iteration; ``number`` counts solves from 1, 0 before."""

    number: int = 0
    title: str = ""
    status: str = ""
    begun: float = 0.0
    ended: float = 0.0
    rows: list[dict[str, float]] = field(default_factory=list)

    def add(self, iterate: Iterate) -> None:
        """Add an iterate; a guess begins a new solve."""
        now = time.perf_counter()
        if iterate.stage == "guess":
            unknowns = iterate.transcription.layout.n_unknowns
            parts = (iterate.label, iterate.grid, f"{unknowns} variables", iterate.solver)
            self.number, self.title = self.number + 1, ", ".join(part for part in parts if part)
            self.begun, self.rows, self.status = now, [], ""
        elif iterate.stage == "iteration":
            row = {name: float(iterate.figures.get(name, 0.0)) for name in FIGURES}
            self.rows.append(
                {"iteration": float(iterate.figures["iteration"]), "time": now - self.begun, **row}
            )
        else:
            self.status = iterate.status
        self.ended = now

    @property
    def elapsed(self) -> float:
        """Duration of the present solve so far, or in all if it has ended, s."""
        return (self.ended if self.status else time.perf_counter()) - self.begun

    @property
    def step_time(self) -> float | None:
        """Mean seconds an iteration; None before the second."""
        if len(self.rows) < 2:
            return None
        first, last = self.rows[0], self.rows[-1]
        return (last["time"] - first["time"]) / (len(self.rows) - 1)

    def state(self) -> str:
        """The solver's state, in a word or two."""
        if self.status:
            return self.status
        if not self.rows:
            return "starting"
        return "restoring feasibility" if self.rows[-1]["restoration"] else "solving"

    def troubles(self) -> list[str]:
        """Difficulties of the last step, in words."""
        if not self.rows:
            return []
        row, troubles = self.rows[-1], []
        if row["restoration"]:
            troubles.append("restoration: the objective waits until the rows hold better")
        if row["regularization"] > 0:
            troubles.append(f"Hessian regularised by {row['regularization']:.0e}")
        if row["line_search"] >= MANY_TRIALS:
            troubles.append(f"line search cut the step {row['line_search'] - 1:.0f} times")
        elif len(self.rows) > 1 and 0 < row["step"] < SHORT_STEP:
            troubles.append("a very short step")
        return troubles
