"""``trajopt replay``: solutions in Meshcat, live or as a page."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from trajopt.cli.input import default_option, layout_options
from trajopt.cli.interruption import INTERRUPTION
from trajopt.cli.report import say
from trajopt.solution.output import check_apart, check_output, require_ending


@click.command("replay")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@click.option("--html", type=Path, metavar="OUT", help="Write one self-contained page instead.")
@click.option("--no-open", is_flag=True, help="Do not open a browser.")
@default_option("--speed", 1.0, "S", "Playback speed, 1 is real time.")
@layout_options
def replay_command(
    files: tuple[Path, ...],
    html: Path | None,
    no_open: bool,
    speed: float,
    layout: str | None,
    labels: tuple[str, ...],
) -> None:
    """Show FILE in the browser, or write it to a page.

    Several files are shown in one scene. Without --html it is served by Meshcat until Ctrl-C.
    """
    from trajopt.view.replay.show import replay, serve

    check_apart([html], files)
    if html is not None:
        require_ending(check_output(html), ".html")
    shown = replay(
        files,
        html=html,
        open_browser=not no_open,
        speed=speed,
        layout=layout,
        labels=list(labels) or None,
    )
    if shown.html is not None:
        say(f"{shown.html}: {shown.duration:.2f} s, {shown.size / 1e6:.1f} MB")
        return
    sys.stdout.flush()  # the address is printed before waiting
    with INTERRUPTION.deferring():
        say("Ctrl-C stops the server", err=True)
        serve(shown, lambda: INTERRUPTION.pressed)
        INTERRUPTION.answer()
