"""A live line of a solve's progress, and what Ctrl-C does to it."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType

from rich.console import Console
from rich.status import Status

# What a shell reports for a program ended by Ctrl-C: 128 + SIGINT.
CANCELLED = 130
# Exit status of a run that did not solve its problem.
UNSOLVED = 1
# Seconds after its time limit that a solver may take to finish a step.
GRACE = 30.0
# Rich's spinner, a space, and the last column, which some terminals wrap at.
SPINNER_WIDTH = 3


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
                show_cursor()
                sys.stderr.write("trajopt: cancelled, nothing was written\n")
                sys.stderr.flush()
                os._exit(CANCELLED)


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
        show_cursor()
        sys.stderr.write(
            f"trajopt: the solver did not return within its time limit of {self._max_time:g} s; "
            "nothing was written; try another --solver or start\n"
        )
        sys.stderr.flush()
        os._exit(UNSOLVED)


class LiveLine:
    """One line on stderr that shows the last iteration; silent where stderr is no terminal."""

    def __init__(self, title: str) -> None:
        console = self._console = Console(stderr=True, highlight=False)
        live = sys.stderr.isatty() and not console.is_dumb_terminal
        self._title = title
        self._status = Status(f"{title}: building and compiling", console=console) if live else None

    def __enter__(self) -> LiveLine:
        if self._status:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status:
            self._status.stop()

    def show(self, figures: dict[str, float], stopping: bool) -> None:
        """Replace the line by the figures of this iteration."""
        if self._status:
            state = "stopping" if stopping else "restoration" if figures["restoration"] else "solving"
            text = (
                f"{self._title}: {state}, iteration {figures['iteration']:.0f}, "
                f"objective {figures['objective']:.4g}, violation {figures['primal']:.0e}, "
                f"optimality {figures['dual']:.0e}"
            )
            self._status.update(text[: self._width()])

    def _width(self) -> int:
        """Columns beside the spinner: a text that wraps would be two lines."""
        return max(1, self._console.width - SPINNER_WIDTH)


class Watch:
    """The progress callback of `trajopt.solve` that shows the live line and stops on Ctrl-C."""

    def __init__(self, line: LiveLine, interruption: Interruption, deadline: Deadline) -> None:
        self._line, self._interruption, self._deadline = line, interruption, deadline

    def __call__(self, figures: dict[str, float]) -> bool:
        """Show the figures; return False when the solver shall stop."""
        if self._interruption.cancelled:
            return False
        self._interruption.started = True
        self._deadline.start()
        self._line.show(figures, self._interruption.requested)
        return not self._interruption.requested


@contextmanager
def watched(title: str, max_time: float) -> Iterator[Watch]:
    """A progress callback for one solve of ``max_time`` s at most; Ctrl-C is as before afterwards.

    Raises KeyboardInterrupt at the end if Ctrl-C came before the solver started.
    """
    deadline = Deadline(max_time)
    with Interruption() as interruption, LiveLine(title) as line:
        try:
            yield Watch(line, interruption, deadline)
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
