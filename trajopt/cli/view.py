"""``trajopt replay``, ``render`` and ``plot``: solutions in Meshcat, as pictures and videos, and as plots."""

import contextlib
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from typing_extensions import override

from trajopt.cli.input import WholeNumber, default_option, layout_options, output_option, value_option
from trajopt.cli.interruption import INTERRUPTION
from trajopt.cli.progress import busy
from trajopt.cli.report import say
from trajopt.motion.output import check_apart, check_output, require_ending

LAYERS = (
    "robot, shapes, forces, controller, impulses, cones, com, zmp, "
    "support, trails, ghosts, goals, payloads, obstacles, surfaces or terrain"
)


class PictureSize(click.ParamType):
    """Pixels as in 1280x720."""

    name = "size"

    @override
    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        # Most digits of a side: more would be too many pixels in any case.
        size = re.fullmatch(r"([0-9]{1,6})[xX×]([0-9]{1,6})", str(value).strip(), re.ASCII)
        if size is None:
            self.fail(f"'{value}' is not a size; allowed: WIDTHxHEIGHT in pixels, as in 1280x720", param, ctx)
        return int(size[1]), int(size[2])


@click.command("replay")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@click.option("--html", type=Path, metavar="OUT", help="Write one self-contained page instead.")
@click.option("--no-open", is_flag=True, help="Do not open a browser.")
@default_option("--speed", 1.0, "S", "Playback speed, 1 is real time.")
@layout_options
def replay_command(
    files: tuple[Path, ...], html: Path | None, no_open: bool, labels: tuple[str, ...], **options: Any
) -> None:
    """Show FILE in the browser, or write it to a page.

    Several files are shown in one scene. Without --html it is served by Meshcat until Ctrl-C.
    """
    from trajopt.view.replay.show import replay, serve

    check_apart([html], files)
    if html is not None:
        require_ending(check_output(html), ".html")
    shown = replay(files, html=html, open_browser=not no_open, labels=list(labels) or None, **options)
    if shown.html is not None:
        say(f"{shown.html}: {shown.duration:.2f} s, {shown.size / 1e6:.1f} MB")
        return
    sys.stdout.flush()  # the address is printed before waiting
    with INTERRUPTION.deferring():
        say("Ctrl-C stops the server", err=True)
        serve(shown, lambda: INTERRUPTION.pressed)
        INTERRUPTION.answer()


@click.command("render")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@output_option("OUT", "Ends with .mp4, .webp, .gif, .png.", required=True)
@value_option("--size", "WxH", "Pixels.  [1280x720, a .webp 960x540, a .gif 640x360]", PictureSize())
@click.option("--fps", type=float, metavar="F", help="Pictures per second.  [default: a .mp4 30, others 25]")
@default_option("--speed", 1.0, "S", "Playback speed, 1 is real time.")
@click.option("--camera", metavar="NAME", help="overview, follow, side, front, top or free.")
@click.option("--from", "start", type=float, metavar="S", help="Start there, s of the solution.")
@click.option("--to", "end", type=float, metavar="S", help="End there, s of the solution.")
@click.option("--time", type=float, metavar="S", help="Time of a .png.  [default: in the first flight]")
@click.option("--strip", type=WholeNumber(0, 10**6), metavar="N", help="A .png of N pictures side by side.")
@click.option("--no-caption", is_flag=True, help="No text in the picture.")
@click.option("--hide", "hidden", multiple=True, metavar="LAYER", help=f"Hide a layer: {LAYERS}.")
@click.option("--show", "shown", multiple=True, metavar="LAYER", help="Show a layer; may be repeated.")
@layout_options
def render_command(
    files: tuple[Path, ...], output: Path, no_caption: bool, labels: tuple[str, ...], **options: Any
) -> None:
    """Write the replay of FILE to a video or a picture.

    Several files are shown in one scene.
    """
    from trajopt.view.replay.render import render

    check_apart([output], files)
    options |= {"labels": list(labels) or None, "caption": not no_caption}
    with _progress(output.name) as shown:
        done = render(files, output, progress=shown, **options)
    length = f"{done.pictures} pictures, {done.duration:.2f} s, " if done.duration else ""
    say(f"{done.path}: {length}{done.width}x{done.height}, {done.size / 1e6:.1f} MB")


@click.command("plot")
@click.argument("files", nargs=-1, required=True, type=Path, metavar="FILE...")
@output_option("OUT", "A .png, .svg, .pdf or .html file.", required=True)
@click.option("--label", "labels", multiple=True, metavar="NAME", help="Label of each file, in order.")
@click.option(
    "--page",
    "--pages",
    "pages",
    multiple=True,
    metavar="NAME[,NAME]...",
    help="summary, limits, joints, drives, forces, soles, base, momentum, clearance or accuracy.  "
    "[default: summary for .png and .svg, else all]",
)
def plot_command(
    files: tuple[Path, ...], output: Path, labels: tuple[str, ...], pages: tuple[str, ...]
) -> None:
    """Plot the solution in FILE, with all limits.

    Several FILEs of one robot are overlaid.

    Pages that do not apply to the robot (without contacts, drives or a moving base) are left out.
    """
    from trajopt.view.plotting.writing import write_plots

    check_apart([output], files)
    names = [name.strip() for given in pages for name in given.split(",") if name.strip()]
    with busy(f"plotting {output}"):
        plotted = write_plots(list(files), output, labels=labels or None, pages=names or None)
    shown = ", ".join(dict.fromkeys(plotted.pages))
    say(f"{plotted.path}: {shown}, {plotted.size / 1e6:.2f} MB")


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

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield show
