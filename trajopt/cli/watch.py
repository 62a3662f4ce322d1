"""The options ``--watch`` and ``--log`` of commands that solve."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from trajopt.solution.solution import Solution
    from trajopt.view.watching.viewer import Viewer

Command = TypeVar("Command", bound=Callable[..., Any])


def watch_options(command: Command) -> Command:
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


def opened(watch: bool) -> Viewer | None:
    """A viewer if one is asked for, its place said on stderr; a browser is opened from a terminal alone."""
    if not watch:
        return None
    from trajopt.view.replay.live import where
    from trajopt.view.watching.viewer import Viewer

    viewer = Viewer(open_browser=_at_terminal())
    click.echo(where(viewer.url), err=True)
    return viewer


def kept(viewer: Viewer | None, solution: Solution | None) -> None:
    """Show the solution; at a terminal until Ctrl-C, else end the viewer: a script must not hang."""
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
