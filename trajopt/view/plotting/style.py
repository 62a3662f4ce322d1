"""Style of plots: fonts, colours for the colour-blind, markers for grey print."""

from __future__ import annotations

import io
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito, Color Universal Design (2008), without the yellow, which is too light for lines on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#000000", "#CC79A7", "#56B4E9", "#E69F00")
BLUE, RED, _, BLACK = COLOURS[:4]
# Markers by curve of a panel: they distinguish curves in grey print.
MARKERS = ("o", "s", "^", "D", "v", "x", "+")
# Line styles by solution.
LINES: tuple[Any, ...] = ("-", (0, (4.5, 1.6)), (0, (1.2, 1.2)), (0, (5.0, 1.4, 1.2, 1.4)))
# Line styles of curves of one solution that may overlap: gaps wide enough to see the curve below.
OVERLAID: tuple[Any, ...] = ("-", (0, (4.0, 3.0)), (0, (1.3, 2.6)), (0, (6.0, 2.5, 1.3, 2.5)))
# Collocation points: diameter of their dots in points, and their look.
DOT = 1.7
DOTTED: dict[str, Any] = {
    "linestyle": "none",
    "marker": ".",
    "markersize": 2 * DOT,  # the marker "." is drawn at half its size
    "markeredgewidth": 0.0,
}
GREY, BAND, GRID = "#606060", "#efefef", "#dddddd"
# Colour map of shares of a limit, from light to dark, and the colour of values beyond it.
SHARES, BEYOND = "Blues", "#D55E00"
# Colour map of time, from light to dark; its light end is visible on white.
TIMES = "cividis_r"

TITLE, FONT, SMALL, TINY, SMALLEST = 11.0, 8.0, 7.0, 6.5, 6.0
# Resolution in dots per inch of a picture, and of raster parts of an HTML page.
DOTS = 150

# Most letters of a name given by the user: the longest of the library has 24.
NAME_LETTERS = 32


def colour(number: int) -> str:
    """Return the colour of a curve by its number."""
    return COLOURS[number % len(COLOURS)]


def line_style(number: int) -> Any:
    """Return the line style of a solution by its number."""
    return LINES[number % len(LINES)]


def short(name: str, letters: int = NAME_LETTERS) -> str:
    """Return the name on one line, cut to at most ``letters`` characters."""
    words = " ".join(name.split())
    return words if len(words) <= letters else words[: letters - 1] + "\u2026"


def literal(name: str) -> str:
    """Return the name escaped for Matplotlib: a dollar sign does not begin mathematics."""
    return name.replace("$", r"\$")


TICKS = {"labelsize": SMALL, "major.size": 2.5, "major.width": 0.6, "major.pad": 2.0}
RC: dict[str, Any] = {
    "font.size": FONT,
    "font.family": "DejaVu Sans",
    "axes.titlesize": FONT,
    "axes.labelsize": SMALL,
    "axes.labelpad": 2.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.4,
    **{f"{axis}tick.{name}": value for axis in "xy" for name, value in TICKS.items()},
    "lines.linewidth": 1.1,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "legend.borderpad": 0.0,
    "legend.labelspacing": 0.2,
    "legend.handlelength": 2.8,
    "legend.handletextpad": 0.4,
    "hatch.linewidth": 0.4,
    "svg.fonttype": "path",
    "svg.hashsalt": "trajopt",
    "pdf.fonttype": 42,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


def look() -> AbstractContextManager[None]:
    """Return a context with this style, whatever the user's settings are."""
    import matplotlib as mpl

    settings: dict[Any, Any] = {**mpl.rcParamsDefault, **RC, "backend": mpl.rcParams["backend"]}
    return mpl.rc_context(settings)


def rendered(figure: Figure, ending: str) -> bytes:
    """Return a figure as the content of a .png, .svg or .pdf file; equal figures give equal files."""
    date = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}[ending]
    buffer = io.BytesIO()
    with look():
        figure.savefig(buffer, format=ending[1:], metadata=date)
    return buffer.getvalue()
