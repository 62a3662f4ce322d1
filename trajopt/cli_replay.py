"""The command ``trajopt replay``."""

from __future__ import annotations

import sys
from pathlib import Path

import click


@click.command()
@click.argument("file", type=Path)
@click.option("--html", type=Path, metavar="OUT", help="Write one self-contained page instead.")
@click.option("--no-open", is_flag=True, help="Do not open a browser.")
def replay(file: Path, html: Path | None, no_open: bool) -> None:
    """Show FILE in Meshcat until Ctrl-C, or write it to a page."""
    from trajopt.replay import replay as show
    from trajopt.replay import serve
    from trajopt.solution import Solution

    shown = show(Solution.load(file), html=html, open_browser=not no_open)
    if shown.html is not None:
        click.echo(f"{shown.html}: {shown.duration:.2f} s, {shown.size / 1e6:.1f} MB")
        return
    sys.stdout.flush()  # where it is shown, before waiting
    try:
        click.echo("Ctrl-C stops the server", err=True)
        serve(shown)
    except KeyboardInterrupt:
        pass
    finally:
        shown.close()
