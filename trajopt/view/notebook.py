"""Replays and plots inside a notebook, as the value of a cell in Jupyter, VS Code and others."""

import html
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.motion.solution import Solution

# Pixels: a page below this height has no room for its controls.
HEIGHT, LEAST_HEIGHT = 460, 120


@dataclass(frozen=True)
class InlineReplay:
    """A self-contained page in a frame: it needs no server, and also plays in a saved notebook."""

    page: str = field(repr=False)
    height: int = HEIGHT

    def _repr_html_(self) -> str:
        # The page is the frame's source text: trusted as much as the notebook, without a file beside it.
        text = html.escape(self.page, quote=True)
        return f'<iframe srcdoc="{text}" style="width: 100%; height: {self.height}px; border: 0"></iframe>'


@dataclass(frozen=True)
class InlinePlot:
    """A plot as a PNG picture."""

    png: bytes = field(repr=False)

    def _repr_png_(self) -> bytes:
        return self.png


@checked
def show(
    solutions: Solution | Sequence[Solution],
    *,
    speed: float = 1.0,
    layout: str | None = None,
    labels: Sequence[str] | None = None,
    height: int = HEIGHT,
) -> InlineReplay:
    """Return the replay of one or several solutions for a notebook: the last value of a cell is shown.

    Args:
        solutions: One or several, or the paths of their files.
        speed: Solution time over playback time; 1 is real time.
        layout: Of several solutions, "overlaid" or "side-by-side"; default: side by side if their
            robots differ.
        labels: Their names.
        height: Of the frame, pixels.

    Raises:
        InputError: For a height that leaves no room for the controls, and as `trajopt.replay`.
    """
    from trajopt.view.replay.show import replay

    if height < LEAST_HEIGHT:
        raise InputError(f"height is {height}", f"allowed: {LEAST_HEIGHT} pixels or more")
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        replay(solutions, html=page, speed=speed, layout=layout, labels=labels)
        return InlineReplay(page.read_text(encoding="utf-8"), height)


@checked
def plots(
    solutions: Solution | Sequence[Solution],
    *,
    labels: Sequence[str] | None = None,
    pages: Sequence[str] | None = None,
) -> InlinePlot:
    """Return the plots of solutions of one robot for a notebook.

    Args:
        solutions: One or several, overlaid.
        labels: A name for each.
        pages: Names of pages; default the summary.

    Raises:
        InputError: As `trajopt.view.plotting.write_plots`.
    """
    from trajopt.view.plotting.writing import write_plots

    with tempfile.TemporaryDirectory() as folder:
        return InlinePlot(
            write_plots(solutions, Path(folder) / "plot.png", labels=labels, pages=pages).path.read_bytes()
        )
