"""The convergence of a solve in a terminal: a few lines that are updated in place."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Sequence

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.text import Text

from trajopt.solving.monitoring import Iterate
from trajopt.view.watching.record import History

BLOCKS = "▁▂▃▄▅▆▇█"
ASCII = ".:-=+*#@"
# The character for a figure that is not finite.
MISSING = "?"
# Decades that a line spans at least: a series that hardly changes is a flat line.
LEAST_DECADES = 1.0
# On a linear scale, the least span of a line, as a fraction of the largest value.
FLAT = 1e-3
# Updates per second. A thread of rich draws them: the solver does not wait.
RATE = 10.0
FRAMES, ASCII_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏", "|/-\\"
# Columns of a figure's name and of its number.
NAME, NUMBER = 14, 12
ROWS = {"objective": "objective", "primal": "infeasibility", "dual": "optimality"}
# The last column stays empty: some terminals wrap at it.
EDGE = 1


def sparkline(values: Sequence[float], width: int, *, linear: bool = False, blocks: str = BLOCKS) -> str:
    """Draw ``values`` (n,) on a logarithmic, or ``linear``, scale in at most ``width`` characters.

    If there are more values than characters, each character shows the largest of a run. On the logarithmic
    scale zero is the lowest level; values without a logarithm are shown as ``MISSING``.
    """
    if width < 1 or not values:
        return ""
    count = min(width, len(values))
    edges = [round(i * len(values) / count) for i in range(count + 1)]
    runs = [values[low:high] for low, high in itertools.pairwise(edges)]
    levels = [math.nan if any(map(math.isnan, run)) else max(run) for run in runs]
    if not linear:
        levels = [math.log10(v) if v > 0 else -math.inf if v == 0 else math.nan for v in levels]
    known = [level for level in levels if math.isfinite(level)]
    high = max(known, default=0.0)
    least = FLAT * abs(high) if linear else LEAST_DECADES
    low = min(min(known, default=0.0), high - least)
    return "".join(_block(level, low, high, blocks) for level in levels)


def _block(level: float, low: float, high: float, blocks: str) -> str:
    if math.isnan(level) or level == math.inf:
        return MISSING
    if level == -math.inf:
        return blocks[0]
    part = (level - low) / (high - low) if high > low else 0.0
    return blocks[min(len(blocks) - 1, int(part * len(blocks)))]


class ConvergencePanel:
    """A watch that shows a title, the solve, its objective and residuals over iterations, and difficulties.

    A context manager; silent unless stderr is a terminal that can move its cursor.
    """

    def __init__(self, title: str, stopping: Callable[[], bool] | None = None) -> None:
        self._console = Console(stderr=True, highlight=False, markup=False)
        live = sys.stderr.isatty() and not self._console.is_dumb_terminal
        self._history, self._title, self._stopping, self._frame = History(), title, stopping, 0
        self._live = (
            Live(self, console=self._console, transient=True, refresh_per_second=RATE) if live else None
        )

    def __enter__(self) -> ConvergencePanel:
        if self._live:
            self._live.start(refresh=True)
        return self

    def __exit__(self, *error: object) -> None:
        if self._live:
            self._live.stop()

    def __call__(self, iterate: Iterate) -> None:
        """Add an iterate; the display follows within a tenth of a second."""
        if self._live:
            self._history.add(iterate)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        self._frame += 1
        width = max(1, options.max_width - EDGE)
        plain = options.ascii_only
        frames = ASCII_FRAMES if plain else FRAMES
        spinner = frames[self._frame % len(frames)]
        stopping = self._stopping is not None and self._stopping()
        for line in panel_lines(self._history, self._title, width - 2, plain=plain, stopping=stopping):
            yield Text(f"{spinner} {line}", no_wrap=True, overflow="crop")
            spinner = " "


def panel_lines(
    history: History, title: str, width: int, *, plain: bool = False, stopping: bool = False
) -> list[str]:
    """Lines of the panel, each at most ``width`` columns wide; ``plain`` uses ASCII only."""
    if history.number == 0:
        return [_fitting(f"{title}: building and compiling", width)]
    state = "stopping" if stopping and not history.status else history.state()
    count = f", iteration {history.rows[-1]['iteration']:.0f}" if history.rows else ""
    pace = "" if history.step_time is None else f", {_seconds(history.step_time)} a step"
    head = f"{title}: {state}{count}, {_seconds(history.elapsed)}{pace}"
    lines = [head, history.title]
    if history.rows:
        room = width - NAME - NUMBER - 1
        lines += [_row(history, name, room, ASCII if plain else BLOCKS) for name in ROWS]
        row = history.rows[-1]
        barrier = f", barrier {row['barrier']:.0e}" if row["barrier"] > 0 else ""
        lines.append(f"step {row['step']:.2g}{barrier}" + "".join(f"; {text}" for text in history.troubles()))
    return [_fitting(line, width) for line in lines]


def _row(history: History, name: str, room: int, blocks: str) -> str:
    values = [row[name] for row in history.rows]
    text = f"{values[-1]:.6g}" if name == "objective" else f"{values[-1]:.1e}"
    linear = name == "objective"
    return f"{ROWS[name]:<{NAME}}{text:<{NUMBER}} {sparkline(values, room, linear=linear, blocks=blocks)}"


def _seconds(value: float) -> str:
    return f"{1e3 * value:.0f} ms" if value < 1 else f"{value:.1f} s" if value < 100 else f"{value:.0f} s"


def _fitting(text: str, width: int) -> str:
    """The text, cut to ``width`` columns: a line that wraps would not be cleared."""
    while cell_len(text) > width:
        text = text[:-1]
    return text
