"""What the command line does while a solver runs: Ctrl-C, a last deadline, and who is told of iterations."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from trajopt.solving.monitoring import GRACE

if TYPE_CHECKING:
    from trajopt.solving.monitoring import Watch

# What a shell reports for a program ended by Ctrl-C: 128 + SIGINT.
CANCELLED = 130
# Exit status of a run that did not solve its problem.
UNSOLVED = 1
# The ``log`` that is a line an iteration on stderr.
LINES = "-"


class Interruption:
    """Ctrl-C while a solver runs: the first asks it to stop at its iterate, the second ends the program.

    Before ``started`` is set a Ctrl-C is the usual KeyboardInterrupt; ``cancelled`` remembers it, because
    CasADi's bindings lose exceptions that arise while they try conversions. The second one is answered
    from a thread, because a solver that makes no more iterations never lets Python's handler run. Where
    Ctrl-C is ignored (nohup), or outside the main thread, nothing is changed.
    """

    def __init__(self) -> None:
        self.started = False
        self.cancelled = False
        self.requested = False
        self._presses = 0
        self._active = False

    def __enter__(self) -> Interruption:
        self._active = (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
        )
        if self._active:
            self._read, self._write = os.pipe()
            os.set_blocking(self._write, False)
            self._watcher = threading.Thread(target=self._watch, args=(self._read,), daemon=True)
            self._watcher.start()
            self._previous_fd = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            self._previous = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._active:
            signal.signal(signal.SIGINT, self._previous)
            signal.set_wakeup_fd(self._previous_fd)
            os.close(self._write)  # ends the watcher
            self._watcher.join()
            os.close(self._read)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if not self.started:
            self.cancelled = True
            raise KeyboardInterrupt
        self.requested = True

    def _watch(self, descriptor: int) -> None:
        while data := os.read(descriptor, 1):
            self._presses += data[0] == signal.SIGINT
            if self._presses > 1:
                _end("trajopt: cancelled, nothing was written\n", CANCELLED)


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
        _end(
            f"trajopt: the solver did not return within its time limit of {self._max_time:g} s; "
            "nothing was written; try another --solver or start\n",
            UNSOLVED,
        )


class Control:
    """The progress callback of `trajopt.solve` that stops on Ctrl-C, and starts the deadline's clock."""

    def __init__(self, interruption: Interruption, deadline: Deadline) -> None:
        self._interruption, self._deadline = interruption, deadline

    def __call__(self, figures: dict[str, float]) -> bool:
        """Return False when the solver shall stop."""
        if self._interruption.cancelled:
            return False
        self._interruption.started = True
        self._deadline.start()
        return not self._interruption.requested


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
    from trajopt.view.watching.panel import Panel
    from trajopt.view.watching.record import Lines, Table

    deadline = Deadline(max_time)
    with ExitStack() as stack:
        table = stack.enter_context(Table(log)) if log not in (None, LINES) else None
        interruption = stack.enter_context(Interruption())
        shown = (
            Lines(sys.stderr, title)
            if log == LINES
            else stack.enter_context(Panel(title, lambda: interruption.requested))
        )
        try:
            yield {
                "progress": Control(interruption, deadline),
                "watch": combine_watches(shown, table, viewer),
            }
        except Exception:
            if not interruption.cancelled:
                raise
        finally:
            deadline.cancel()
        if interruption.cancelled:
            raise KeyboardInterrupt


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


def show_cursor() -> None:
    """Undo what a live line does to the terminal's cursor."""
    if sys.stderr.isatty():
        sys.stderr.write("\x1b[?25h\n")


def _end(text: str, status: int) -> None:
    """End the program at once, from any thread: a solver that does not return lets nothing else do."""
    show_cursor()
    sys.stderr.write(text)
    sys.stderr.flush()
    os._exit(status)
