"""A report of one or several solutions, as pictures, a document to print, or one HTML file."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.solution.input import solutions_of
from trajopt.solution.output import check_output, replacing
from trajopt.solution.solution import Solution
from trajopt.versions import installed_version
from trajopt.view.plotting import style
from trajopt.view.plotting.facts import sections, title_of
from trajopt.view.plotting.figure import figure_of
from trajopt.view.plotting.html import html_page
from trajopt.view.plotting.page import PlotPage, Tracks
from trajopt.view.plotting.summary import PAGES, pages_of
from trajopt.view.plotting.track import tracks_of

# Default pages by suffix: a picture has the summary, a document all pages.
DEFAULT_PAGES = {".png": ("summary",), ".svg": ("summary",), ".pdf": tuple(PAGES), ".html": tuple(PAGES)}


@dataclass(frozen=True, kw_only=True)
class Plotted:
    """What was written: the file, its size in bytes, and the names of its pages in their order."""

    path: Path
    size: int
    pages: tuple[str, ...]


@checked
def write_plots(
    solutions: Solution | str | Path | Sequence[Solution | str | Path],
    target: str | Path,
    *,
    labels: Sequence[str] | None = None,
    pages: Sequence[str] | None = None,
) -> Plotted:
    """Plot one solution, or several of one robot overlaid, to ``target``.

    Args:
        solutions: Solutions or their files; the first is drawn with full lines, shaded phases and points.
        target: Ends with .png, .svg (one picture; default the summary page), .pdf (A4 pages) or .html (one
            file that needs no network; both with all pages).
        labels: A name for each solution.
        pages: Names of `summary.PAGES`; pages about what the robot does not have are left out.

    Raises:
        InputError: For another suffix, a file that cannot be written, an unknown page, or solutions of
            several robots.
        SolutionFileError: For a file that cannot be read.
    """
    place = Path(target)
    ending = place.suffix.lower()
    if ending not in DEFAULT_PAGES:
        raise InputError(
            f"cannot plot to {place}: its ending is '{ending}'", f"allowed: {', '.join(DEFAULT_PAGES)}"
        )
    place = check_output(place)
    read = solutions_of(solutions)
    for one in read:
        if one.n_samples < 2:
            raise InputError(f"the solution has {one.n_samples} samples", "allowed: two or more")
    with np.errstate(all="ignore"):  # a diverged iterate may overflow
        tracks = tracks_of(read, labels)
        chosen = pages_of(tracks, pages or DEFAULT_PAGES[ending])
        content = _content(chosen, tracks, ending)
    with replacing(place) as unfinished:
        unfinished.write_bytes(content)
    return Plotted(path=place, size=len(content), pages=tuple(page.name for page in chosen))


def _content(pages: Sequence[PlotPage], tracks: Tracks, ending: str) -> bytes:
    maker = f"trajopt {installed_version('trajopt')}"
    if ending == ".html":
        tables = sections(tracks)  # first: the pages show figures measured here
        svgs = [(page, style.rendered(figure_of([page], tracks), ".svg")) for page in pages]
        return html_page(tracks, svgs, tables).encode()
    if ending != ".pdf":
        return style.rendered(figure_of(pages, tracks, footer=maker), ending)
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    facts = {"Title": title_of(tracks), "Creator": "trajopt", "CreationDate": None}  # for equal files
    with style.look(), PdfPages(buffer, metadata=facts) as document:
        for number, page in enumerate(pages, 1):
            footer = f"{maker}, page {number} of {len(pages)}"
            document.savefig(figure_of([page], tracks, fixed=True, footer=footer))
    return buffer.getvalue()
