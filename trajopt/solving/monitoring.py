"""Monitor a solve: iterates, user callbacks, and the solver callback that calls them.

The motion of an iterate is computed only when it is used.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import pinocchio as pin

from trajopt.motion.solution import Solution
from trajopt.solvers.result import Result
from trajopt.solving.extraction import extract
from trajopt.transcription.layout import Layout
from trajopt.transcription.transcription import Transcription

IterateStage = Literal["guess", "iteration", "end"]
# Called with the figures of each iteration; returns False to stop there.
ProgressCallback = Callable[[dict[str, float]], bool]


@dataclass(frozen=True, kw_only=True, eq=False)
class Iterate:
    """One iterate of a solve.

    Args:
        stage: ``guess`` before the solver starts, ``iteration``, or ``end`` after it has returned.
        figures: iteration, objective (in the problem's weights), primal and dual infeasibility (scaled),
            barrier, step, regularization, line_search (trials), restoration; empty for a guess, only the
            first four at the end.
        label: Which of several solves this is, or empty.
        status: How the solve ended, in words, or empty.
    """

    stage: IterateStage
    transcription: Transcription
    read: Callable[[], np.ndarray] = field(repr=False)
    figures: Mapping[str, float] = field(default_factory=dict)
    solver: str = ""
    label: str = ""
    status: str = ""

    @cached_property
    def unknowns(self) -> np.ndarray | None:
        """Scaled variables (n,); None if the solver does not provide them.

        Read them while the watch is called; a copy is kept. The first read raises RuntimeError if the solver
        has moved on.
        """
        unknowns = np.array(self.read(), dtype=float)
        return unknowns if unknowns.size == self.transcription.layout.n_unknowns else None

    @property
    def grid(self) -> str:
        """Scheme and number of intervals, in words."""
        layout = self.transcription.layout
        return f"{layout.mesh.transcription}, {layout.n_intervals} intervals"

    def solution(self) -> Solution:
        """Return the iterate as a solution with motion, torques and wrenches; takes some 40 ms on a jump.

        Raises as ``unknowns``, and RuntimeError if the solver does not provide the variables.
        """
        if self.unknowns is None:
            raise RuntimeError(f"{self.solver} does not provide the variables of this iteration")
        return extract(
            self.transcription,
            self.unknowns,
            solver=self.solver,
            status=self.status or self.stage,
            more=dict(self.figures),
        )

    def configurations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times (n,) s, configurations (n, nq) and phases (n,) at all nodes with finite values.

        Cheaper than `solution`. A node between two phases belongs to the later one; rotations are normalised.
        """
        layout = self.transcription.layout
        if self.unknowns is None:
            return np.zeros(0), np.zeros((0, layout.robot.model.nq)), np.zeros(0, dtype=int)
        nodes = np.append(layout.interval_stages, layout.interval_stages[-1] + 1)
        phases = layout.phase_of[np.append(layout.interval_stages, layout.interval_stages[-1])]
        with np.errstate(all="ignore"):  # a rotation of length zero becomes NaN
            unknowns = self.unknowns * self.transcription.scale
            t = layout.times(unknowns)[nodes]
            raw = _by_phase(layout, unknowns, nodes, phases)
            q = np.array([pin.normalize(layout.robot.model, row) for row in raw])
        good = np.isfinite(q).all(axis=1) & np.isfinite(t)
        return t[good], q[good], phases[good]


# Called with the guess, every iterate, and the end of a solve.
Watch = Callable[[Iterate], None]


def combine_watches(*watches: Watch | None) -> Watch:
    """Combine several watches into one; a watch that raises is dropped with a warning.

    An exception in a watch must not end a solve; a keyboard interrupt passes through.
    """
    left = [watch for watch in watches if watch is not None]

    def call(iterate: Iterate) -> None:
        for watch in tuple(left):
            try:
                watch(iterate)
            except Exception as error:
                left.remove(watch)
                text = " ".join(f"{type(error).__name__}: {error}".split())
                warnings.warn(f"watching has stopped, solving goes on: {text}", stacklevel=2)

    return call


class ProgressReporter:
    """Solver callback that calls progress and watch, with the objective in the problem's weights."""

    def __init__(
        self,
        transcription: Transcription,
        progress: ProgressCallback | None,
        watch: Watch | None,
        solver: str,
        label: str,
    ) -> None:
        self.transcription, self.solver, self.label = transcription, solver, label
        self.progress, self.watch = progress, watch and combine_watches(watch)

    def __call__(self, figures: dict[str, float], unknowns: Callable[[], np.ndarray]) -> bool:
        """Report one iteration; ``unknowns`` may be called until this returns. False stops the solver."""
        reported = {**figures, "objective": self.transcription.objective_unit * figures["objective"]}
        go_on = self.progress is None or self.progress(reported)
        self.see("iteration", unknowns, reported)
        return go_on

    def end(self, result: Result, status: str) -> None:
        """Call the watch with the solver's result."""
        objective = self.transcription.objective_unit * result.objective
        figures = {"iteration": result.iterations, "objective": objective}
        figures |= {"primal": result.primal, "dual": result.dual}
        self.see("end", lambda: result.x, figures, status.replace("_", " "))

    def see(
        self,
        stage: IterateStage,
        read: Callable[[], np.ndarray],
        figures: Mapping[str, float] | None = None,
        status: str = "",
    ) -> None:
        """Call the watch with an iterate."""
        if self.watch is None:
            return
        iterate = Iterate(
            stage=stage,
            transcription=self.transcription,
            read=read,
            figures=figures or {},
            solver=self.solver,
            label=self.label,
            status=status,
        )
        self.watch(iterate)


def _by_phase(layout: Layout, unknowns: np.ndarray, nodes: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return configurations of the whole robot at nodes in time order, computed phase by phase."""
    parts = []
    for phase in dict.fromkeys(phases.tolist()):
        form = layout.form_of(phase)
        states = form.state(
            np.array([unknowns[layout.node(node)] for node in nodes[phases == phase].tolist()])
        )
        q, _ = form.coordinates.node_to_pinocchio(states)
        mode = layout.modes.get(layout.schedule.phases[phase].name)
        parts.append(q if mode is None else mode.lifted(q)[0])
    return np.vstack(parts)
