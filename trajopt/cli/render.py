"""``trajopt render``: a replay as a video, a GIF or a picture."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from typing_extensions import override

from trajopt.cli.input import WholeNumber, default_option, layout_options
from trajopt.cli.report import say
from trajopt.solution.output import check_apart

# Most digits of a side: more would be too many pixels in any case.
_SIZE = re.compile(r"([0-9]{1,6})[xX×]([0-9]{1,6})", re.ASCII)
LAYERS = (
    "robot, shapes, forces, controller, impulses, cones, com, zmp, "
    "support, trails, ghosts, goals, payloads, obstacles, surfaces or terrain"
)
ANY_COUNT = WholeNumber(0, 10**6)


class PictureSize(click.ParamType):
    """Pixels as in 1280x720."""

    name = "size"

    @override
    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        found = _SIZE.fullmatch(str(value).strip())
        if found is None:
            self.fail(f"'{value}' is not a size; allowed: WIDTHxHEIGHT in pixels, as in 1280x720", param, ctx)
        return int(found[1]), int(found[2])


@click.command("render")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@click.option(
    "-o", "--output", required=True, type=Path, metavar="OUT", help="Ends with .mp4, .webp, .gif, .png."
)
@click.option(
    "--size",
    type=PictureSize(),
    metavar="WxH",
    help="Pixels.  [1280x720, a .webp 960x540, a .gif 640x360]",
)
@click.option("--fps", type=float, metavar="F", help="Pictures per second.  [default: a .mp4 30, others 25]")
@default_option("--speed", 1.0, "S", "Playback speed, 1 is real time.")
@click.option("--camera", metavar="NAME", help="overview, follow, side, front, top or free.")
@click.option("--from", "start", type=float, metavar="S", help="Start there, s of the solution.")
@click.option("--to", "end", type=float, metavar="S", help="End there, s of the solution.")
@click.option("--time", type=float, metavar="S", help="Time of a .png.  [default: in the first flight]")
@click.option("--strip", type=ANY_COUNT, metavar="N", help="A .png of N pictures side by side.")
@click.option("--no-caption", is_flag=True, help="No text in the picture.")
@click.option("--hide", "hidden", multiple=True, metavar="LAYER", help=f"Hide a layer: {LAYERS}.")
@click.option("--show", "shown", multiple=True, metavar="LAYER", help="Show a layer; may be repeated.")
@layout_options
def render_command(
    files: tuple[Path, ...],
    output: Path,
    no_caption: bool,
    labels: tuple[str, ...],
    **options: Any,
) -> None:
    """Write the replay of FILE to a video or a picture.

    Several files are shown in one scene.
    """
    from trajopt.view.replay.render import render

    check_apart([output], files)
    with _progress(f"{output.name}") as shown:
        done = render(
            files,
            output,
            labels=list(labels) or None,
            progress=shown,
            caption=not no_caption,
            **options,
        )
    length = f"{done.pictures} pictures, {done.duration:.2f} s, " if done.duration else ""
    say(f"{done.path}: {length}{done.width}x{done.height}, {done.size / 1e6:.1f} MB")


@contextlib.contextmanager
def _progress(title: str) -> Iterator[Callable[[int, int], None] | None]:
    """Progress bar on stderr, removed at the end; None if stderr is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def show(done: int, all_of_them: int) -> None:
            bar.update(task, completed=done, total=all_of_them)

        yield show
