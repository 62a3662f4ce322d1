"""What the command line does while a solver runs: Ctrl-C, a last deadline, and who is told of iterations."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from trajopt.solving.interruption import GRACE, Interruption, end_at_once, interruptible

if TYPE_CHECKING:
    from trajopt.solving.monitoring import Watch

# Exit status of a run that did not solve its problem.
UNSOLVED = 1
# The ``log`` that is a line an iteration on stderr.
LINES = "-"
# What the second Ctrl-C loses while a problem is solved.
LOST = ", nothing was written"


class Deadline:
    """Ends the program when a solver has not returned ``GRACE`` seconds after its time limit.

    The last resort: solvers look at their limit between steps, FATROP inside them too, and one factorisation
    of a large problem may take long. A solver in another thread cannot be stopped from outside, so the
    program ends, with nothing written.
    """

    def __init__(self, max_time: float) -> None:
        self._max_time = max_time
        self._timer: threading.Timer | None = None

    def start(self) -> None:
        """Start the clock, once, when the solver starts."""
        if self._timer is None and self._max_time + GRACE < threading.TIMEOUT_MAX:
            self._timer = threading.Timer(self._max_time + GRACE, self._end)
            self._timer.daemon = True
            self._timer.start()

    def cancel(self) -> None:
        """The solver has returned."""
        if self._timer is not None:
            self._timer.cancel()

    def _end(self) -> None:
        end_at_once(
            f"trajopt: the solver did not return within its time limit of {self._max_time:g} s; "
            "nothing was written; try another --solver or start\n",
            UNSOLVED,
        )


class SolveControl:
    """The progress callback of `trajopt.solve` that stops on Ctrl-C, and starts the deadline's clock.

    From the first iteration on a press raises nothing: it stops the solver at its iterate.
    """

    def __init__(self, interruption: Interruption, deadline: Deadline) -> None:
        self._interruption, self._deadline = interruption, deadline
        self._started = False

    def __call__(self, figures: dict[str, float]) -> bool:
        """Return False when the solver shall stop."""
        if not self._interruption.pressed:
            self._interruption.record()
            self._started = True
        self._deadline.start()
        return not self._interruption.pressed

    @property
    def stopping(self) -> bool:
        """Whether the solver is asked to stop."""
        return self._started and self._interruption.pressed

    def settle(self) -> None:
        """The solves have ended: raise KeyboardInterrupt if Ctrl-C came before the first one started."""
        if not self._started:
            self._interruption.check()
        elif self._interruption.pressed:
            self._interruption.stops = True
            self._interruption.answer()


@contextmanager
def watched(
    title: str, max_time: float, log: str | None = None, viewer: Watch | None = None
) -> Iterator[dict[str, Any]]:
    """``progress`` and ``watch`` for solves of ``max_time`` s at most; Ctrl-C is as before afterwards.

    On a terminal the watch shows the convergence. log: a file for a table of all iterations, or ``-`` for a
    line an iteration on stderr, instead. viewer: another watch. Raises `InputError` for a file that cannot be
    written, and KeyboardInterrupt at the end if Ctrl-C came before the solver started.
    """
    from trajopt.solving.monitoring import combine_watches
    from trajopt.view.watching.panel import ConvergencePanel
    from trajopt.view.watching.record import IterationLines, IterationTable

    deadline = Deadline(max_time)
    with ExitStack() as stack:
        interruption = stack.enter_context(interruptible())
        stack.enter_context(interruption.recording())
        interruption.note = LOST
        stack.callback(setattr, interruption, "note", "")
        control = SolveControl(interruption, deadline)
        table = stack.enter_context(IterationTable(log)) if log not in (None, LINES) else None
        shown = (
            IterationLines(sys.stderr, title)
            if log == LINES
            else stack.enter_context(ConvergencePanel(title, lambda: control.stopping))
        )
        try:
            with interruption.raising():
                yield {"progress": control, "watch": combine_watches(shown, table, viewer)}
        except Exception:
            interruption.check()  # the error may be what has become of a press
            raise
        finally:
            deadline.cancel()
        control.settle()


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Send what libraries print to the process's stdout to stderr: stdout carries results only."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
