"""A solver's callback: tells the progress, which may stop it, and the watch, which may not."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from trajopt.solvers.result import Result
from trajopt.solving.iterate import Iterate, Stage, Watch, combined
from trajopt.transcription.transcription import Transcription

# Told the figures of each iteration; returns False to stop there.
Progress = Callable[[dict[str, float]], bool]


class Teller:
    """The solver's callback: tells progress and watch, with the objective in the problem's weights."""

    def __init__(
        self,
        transcription: Transcription,
        progress: Progress | None,
        watch: Watch | None,
        solver: str,
        label: str,
    ) -> None:
        self.transcription, self.solver, self.label = transcription, solver, label
        self.progress = progress
        self.watch = None if watch is None else combined(watch)

    def __call__(self, figures: dict[str, float], unknowns: Callable[[], np.ndarray]) -> bool:
        """One iteration; ``unknowns`` may be called before this returns. False stops the solver."""
        told = {**figures, "objective": self.transcription.objective_unit * figures["objective"]}
        go_on = self.progress is None or self.progress(told)
        self.see("iteration", unknowns, told)
        return go_on

    def end(self, result: Result, status: str) -> None:
        """The solver has returned."""
        figures = {
            "iteration": result.iterations,
            "objective": self.transcription.objective_unit * result.objective,
            "primal": result.primal,
            "dual": result.dual,
        }
        self.see("end", lambda: result.x, figures, status.replace("_", " "))

    def see(
        self,
        stage: Stage,
        read: Callable[[], np.ndarray],
        figures: Mapping[str, float] | None = None,
        status: str = "",
    ) -> None:
        """Show the watch an iterate."""
        if self.watch is not None:
            self.watch(
                Iterate(
                    stage=stage,
                    transcription=self.transcription,
                    read=read,
                    figures=figures or {},
                    solver=self.solver,
                    label=self.label,
                    status=status,
                )
            )
