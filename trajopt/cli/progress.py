"""While a solver runs: Ctrl-C, a final deadline, and the display of iterations."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from trajopt.cli.input import NOT_REACHED
from trajopt.solving.interruption import GRACE, Interruption, end_at_once, interruptible

if TYPE_CHECKING:
    from trajopt.solving.monitoring import Watch

# Value of ``log`` for a line per iteration on stderr.
LINES = "-"
# Seconds between two displays of `busy`; and what clears the rest of a terminal's line.
SECOND, CLEAR = 1.0, "\x1b[K"
# Added to the message of a second Ctrl-C while a problem is solved.
LOST = ", nothing was written"


class SolveControl:
    """The progress callback of `trajopt.solve` that stops on Ctrl-C, and ends a solver that hangs.

    From the first iteration on, Ctrl-C raises nothing but stops the solver at its iterate. If a solver has
    not returned ``GRACE`` seconds after its time limit, the program ends and nothing is written. That is the
    last resort: solvers test their time limit between steps, FATROP within steps too, and one factorisation
    of a large problem may take long. A solver in another thread cannot be stopped from outside.
    """

    def __init__(self, interruption: Interruption, max_time: float) -> None:
        self._interruption, self._max_time = interruption, max_time
        self._started = False
        self._timer = threading.Timer(min(max_time + GRACE, threading.TIMEOUT_MAX), self._end)
        self._timer.daemon = True
        self.cancel_deadline = self._timer.cancel

    def __call__(self, figures: dict[str, float]) -> bool:
        """Return False to stop the solver."""
        if not self._interruption.pressed:
            self._interruption.record()
            self._started = True
        if self._timer.ident is None:
            self._timer.start()
        return not self._interruption.pressed

    @property
    def stopping(self) -> bool:
        """Whether the solver has been asked to stop."""
        return self._started and self._interruption.pressed

    def settle(self) -> None:
        """The solves have ended: raise KeyboardInterrupt if Ctrl-C came before the first one started."""
        if not self._started:
            self._interruption.check()
        elif self._interruption.pressed:
            self._interruption.stops = True
            self._interruption.answer()

    def _end(self) -> None:
        end_at_once(
            f"trajopt: the solver did not return within its time limit of {self._max_time:g} s; "
            "nothing was written; try another --solver or start\n",
            NOT_REACHED,
        )


@contextmanager
def watched(
    title: str, max_time: float, log: str | None = None, viewer: Watch | None = None
) -> Iterator[dict[str, Any]]:
    """Yield ``progress`` and ``watch`` for solves of at most ``max_time`` s; restores Ctrl-C afterwards.

    What libraries print to stdout goes to stderr. On a terminal the watch shows the convergence. log: a file
    for a table of all iterations, or ``-`` for a line per iteration on stderr instead. viewer: another watch.
    Raises `InputError` for a file that cannot be written, and KeyboardInterrupt at the end if Ctrl-C came
    before the solver started.
    """
    from trajopt.solving.monitoring import combine_watches
    from trajopt.view.watching.record import IterationLines, IterationTable

    with ExitStack() as stack:
        stack.enter_context(_stdout_to_stderr())
        interruption = stack.enter_context(interruptible())
        stack.enter_context(interruption.recording())
        interruption.note = LOST
        stack.callback(setattr, interruption, "note", "")
        control = SolveControl(interruption, max_time)
        table = stack.enter_context(IterationTable(log)) if log not in (None, LINES) else None
        shown: Watch | None = None
        if log == LINES:
            shown = IterationLines(sys.stderr, title)
        elif sys.stderr.isatty():  # elsewhere nothing is shown, and Rich is not loaded
            from trajopt.view.watching.panel import ConvergencePanel

            shown = stack.enter_context(ConvergencePanel(title, lambda: control.stopping))
        try:
            with interruption.raising():
                yield {"progress": control, "watch": combine_watches(shown, table, viewer)}
        except Exception:
            interruption.check()  # the error may have been caused by Ctrl-C
            raise
        finally:
            control.cancel_deadline()
        control.settle()


@contextmanager
def busy(text: str) -> Iterator[None]:
    """Say on a terminal what lasts over a second, and for how long it has: a line that goes away.

    Where stderr is no terminal nothing is shown.
    """
    if not sys.stderr.isatty():
        yield
        return
    done, begun = threading.Event(), time.monotonic()

    def show() -> None:
        while not done.wait(SECOND):
            print(f"\r{text}, {time.monotonic() - begun:.0f} s{CLEAR}", end="", file=sys.stderr, flush=True)

    shown = threading.Thread(target=show, name="busy", daemon=True)
    shown.start()
    try:
        yield
    finally:
        done.set()
        shown.join()
        if time.monotonic() - begun >= SECOND:
            print(f"\r{CLEAR}", end="", file=sys.stderr, flush=True)


def runs_to_its_end(work: Callable[[Callable[[], None]], object]) -> bool:
    """Run ``work``; False if Ctrl-C ended it: the function passed to it raises after Ctrl-C."""
    with interruptible() as interruption, interruption.recording():
        try:
            work(interruption.check)
            complete = True
        except KeyboardInterrupt:
            complete = False
        interruption.answer()  # also a Ctrl-C after the work was done
    return complete


@contextmanager
def _stdout_to_stderr() -> Iterator[None]:
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
