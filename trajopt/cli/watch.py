"""The options ``--watch`` and ``--log`` of commands that solve."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from trajopt.solution.solution import Solution
    from trajopt.view.watching.viewer import Viewer

_Command = TypeVar("_Command", bound=Callable[..., Any])


def watch_options(command: _Command) -> _Command:
    """``--watch`` and ``--log``."""
    for option in reversed(
        (
            click.option("--watch", is_flag=True, help="Show the iterates in Meshcat while solving."),
            click.option(
                "--log", metavar="FILE", help="Write all iterations to FILE (CSV); - for lines on stderr."
            ),
        )
    ):
        command = option(command)
    return command


def open_viewer(watch: bool) -> Viewer | None:
    """Start a viewer if ``watch``, print its address on stderr; a browser opens only from a terminal."""
    if not watch:
        return None
    from trajopt.view.replay.live import server_address_text
    from trajopt.view.watching.viewer import Viewer

    viewer = Viewer(open_browser=_at_terminal())
    click.echo(server_address_text(viewer.url), err=True)
    return viewer


def show_until_interrupted(viewer: Viewer | None, solution: Solution | None) -> None:
    """Show the solution until Ctrl-C; without a terminal end the viewer: a script must not hang."""
    if viewer is None:
        return
    try:
        if solution is not None:
            viewer.show(solution)
        viewer.flush()
        if viewer.alive and _at_terminal():
            click.echo(f"shown at {viewer.url}, Ctrl-C stops the server", err=True)
            viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()


def _at_terminal() -> bool:
    return sys.stdout.isatty() and sys.stderr.isatty()
