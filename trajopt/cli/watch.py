"""The options ``--watch`` and ``--log`` of commands that solve."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import click

from trajopt.cli.input import option_group
from trajopt.cli.interruption import INTERRUPTION
from trajopt.cli.report import say

if TYPE_CHECKING:
    from trajopt.solution.solution import Solution
    from trajopt.view.watching.viewer import Viewer

# Seconds between two checks for Ctrl-C.
LOOK = 0.1
# Time limit for drawing the solution, s.
DRAWN = 60.0


watch_options = option_group(
    click.option("--watch", is_flag=True, help="Show the iterates in Meshcat while solving."),
    click.option("--log", metavar="FILE", help="Write all iterations to FILE (CSV); - for lines on stderr."),
)


def open_viewer(watch: bool) -> Viewer | None:
    """Start a viewer if ``watch``, print its address on stderr; a browser opens only from a terminal.

    It is closed with the command, however that ends.
    """
    if not watch:
        return None
    from trajopt.view.replay.live import server_address_text
    from trajopt.view.watching.viewer import Viewer

    viewer = Viewer(open_browser=_at_terminal())
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
        if viewer.alive and _at_terminal() and not leaving():
            say(f"shown at {viewer.url}, Ctrl-C stops the server", err=True)
            while not (leaving() or viewer.wait(LOOK)):
                pass
        INTERRUPTION.answer()
        viewer.close()


def _at_terminal() -> bool:
    return sys.stdout.isatty() and sys.stderr.isatty()
