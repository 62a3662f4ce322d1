"""While a solver runs: Ctrl-C, a final deadline, the display of iterations, ``--watch`` and ``--log``."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import NOT_REACHED, option_group
from trajopt.cli.interruption import INTERRUPTION, end_at_once
from trajopt.cli.report import say
from trajopt.solving.time_limits import GRACE

if TYPE_CHECKING:
    from trajopt.motion.solution import Solution
    from trajopt.solving.monitoring import Watch
    from trajopt.view.watching.viewer import Viewer

# Value of ``log`` for a line per iteration on stderr.
LINES = "-"
# Seconds between two displays of `busy`; and what clears the rest of a terminal's line.
SECOND, CLEAR = 1.0, "\x1b[K"
# Seconds between two checks for Ctrl-C, and the time limit for drawing the solution, s.
LOOK, DRAWN = 0.1, 60.0

watch_options = option_group(
    click.option("--watch", is_flag=True, help="Show the iterates in Meshcat while solving."),
    click.option("--log", metavar="FILE", help="Write all iterations to FILE (CSV); - for lines on stderr."),
)


class SolveControl:
    """The progress callback of `trajopt.solve` that stops on Ctrl-C, and ends a solver that hangs.

    From the first iteration on, Ctrl-C raises nothing but stops the solver at its iterate. If a solver has
    not returned ``GRACE`` seconds after its time limit, the program ends and nothing is written. That is the
    last resort: solvers test their time limit between steps, and one factorisation of a large problem may
    take long. A solver in another thread cannot be stopped from outside.
    """

    def __init__(self, max_time: float) -> None:
        self._max_time, self._started = max_time, False
        self._timer = threading.Timer(min(max_time + GRACE, threading.TIMEOUT_MAX), self._end)
        self._timer.daemon = True

    def __call__(self, figures: dict[str, float]) -> bool:
        """Return False to stop the solver."""
        if not self._started and not INTERRUPTION.pressed:
            self._started = INTERRUPTION.deferred = True
            self._timer.start()
        return not INTERRUPTION.pressed

    @property
    def stopping(self) -> bool:
        """Whether the solver has been asked to stop."""
        return self._started and INTERRUPTION.pressed

    def close(self) -> None:
        """Wait for no solver any more."""
        self._timer.cancel()

    def settle(self) -> None:
        """The solves have ended: raise KeyboardInterrupt if Ctrl-C came before the first one started."""
        if not self._started:
            INTERRUPTION.check()
        elif INTERRUPTION.pressed:
            INTERRUPTION.stops = True
            INTERRUPTION.answer()

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

    control = SolveControl(max_time)
    with INTERRUPTION.handling(), INTERRUPTION.deferring(), _stdout_to_stderr(), ExitStack() as stack:
        stack.callback(control.close)
        table = stack.enter_context(IterationTable(log)) if log not in (None, LINES) else None
        shown: Watch | None = None
        if log == LINES:
            shown = IterationLines(sys.stderr, title)
        elif sys.stderr.isatty():  # elsewhere nothing is shown, and Rich is not loaded
            from trajopt.view.watching.panel import ConvergencePanel

            shown = stack.enter_context(ConvergencePanel(title, lambda: control.stopping))
        try:
            INTERRUPTION.deferred = False  # until the first iteration
            INTERRUPTION.check()
            yield {"progress": control, "watch": combine_watches(shown, table, viewer)}
        except Exception:
            INTERRUPTION.check()  # the error may have been caused by Ctrl-C
            raise
        finally:
            INTERRUPTION.deferred = True
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
    with INTERRUPTION.handling(), INTERRUPTION.deferring():
        try:
            work(INTERRUPTION.check)
            complete = True
        except KeyboardInterrupt:
            complete = False
        INTERRUPTION.answer()  # also a Ctrl-C after the work was done
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


def open_viewer(watch: bool) -> Viewer | None:
    """Start a viewer if ``watch``, print its address on stderr; a browser opens only from a terminal.

    It is closed with the command, however that ends.
    """
    if not watch:
        return None
    from trajopt.view.replay.show import server_address_text
    from trajopt.view.watching.viewer import Viewer

    viewer = Viewer(open_browser=_both_at_terminal())
    click.get_current_context().call_on_close(viewer.close)
    say(server_address_text(viewer.url), err=True)
    return viewer


def show_until_interrupted(viewer: Viewer | None, solution: Solution) -> None:
    """Show the solution until Ctrl-C; without a terminal close the viewer at once: a script must not hang.

    A Ctrl-C that came too late to stop the solver closes it too.
    """
    if viewer is None:
        return
    from trajopt.solving.rounds import INTERRUPTED

    with INTERRUPTION.deferring():
        late = INTERRUPTION.stops and solution.statistics.status != INTERRUPTED

        def leaving() -> bool:
            return late or INTERRUPTION.pressed

        viewer.show(solution)
        end = time.monotonic() + DRAWN
        while not (leaving() or viewer.flush(LOOK) or time.monotonic() > end):
            pass
        if viewer.alive and _both_at_terminal() and not leaving():
            say(f"shown at {viewer.url}, Ctrl-C stops the server", err=True)
            while not (leaving() or viewer.wait(LOOK)):
                pass
        INTERRUPTION.answer()
        viewer.close()


def _both_at_terminal() -> bool:
    return sys.stdout.isatty() and sys.stderr.isatty()
