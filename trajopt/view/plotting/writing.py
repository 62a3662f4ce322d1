"""A report of one or several solutions, as pictures, a document to print, or one HTML file."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError, not_among
from trajopt.simulation.push import PushReport
from trajopt.solution.input import solutions_of
from trajopt.solution.output import check_output, replacing
from trajopt.solution.solution import Solution
from trajopt.versions import installed_version
from trajopt.view.plotting import style
from trajopt.view.plotting import topics_accuracy as accuracy
from trajopt.view.plotting import topics_base as base
from trajopt.view.plotting import topics_contacts as contacts
from trajopt.view.plotting import topics_joints as joints
from trajopt.view.plotting.page import html_page, html_tables
from trajopt.view.plotting.sheet import LOW_ROW, ROW, Sheet
from trajopt.view.plotting.track import Track, title_of, tracks_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Most rows of a map of shares in the summary: with more joints, one row per limb.
MAP_ROWS = 12
# Most limbs whose curves the summary of an arm shows.
FEW_LIMBS = 2


def draw_summary(sheet: Sheet) -> None:
    """Draw contacts, shares of limits, base or joints, forces, momentum or power, and errors."""
    tracks, limbs = sheet.tracks, joints.limbs(sheet.tracks)
    contacts.draw_stances(sheet)
    if len(tracks) > 1:
        joints.draw_largest_shares(sheet)
    elif limbs:
        groups = {name: [axis] for limb in limbs for name, axis in zip(limb.long, limb.axes, strict=True)}
        if len(groups) > MAP_ROWS:
            groups = {limb.name: list(limb.axes) for limb in limbs}
        joints.draw_share_maps(sheet, tracks[0], groups)
        sheet.notes.append(
            "Maps: share of the limit that is used, on the right its largest in per cent; orange: beyond it."
        )
    moving = base.has_base(tracks)
    if moving:
        joints.draw_torques(sheet)
        base.draw_thrust(sheet)
        base.draw_vector(sheet, "base position")
        base.draw_vector(sheet, "base orientation")
    else:
        for limb in limbs[:FEW_LIMBS]:
            joints.draw_limb(sheet, limb, wide=len(limbs) == 1, alone=len(limbs) == 1)
    if contacts.contacts(tracks):
        contacts.draw_normal_forces(sheet)
        contacts.draw_cone_shares(sheet)
    if moving:
        base.draw_vector(sheet, "angular momentum")
    base.draw_clearance(sheet)
    base.draw_power(sheet)
    accuracy.draw_residuals(sheet)
    sheet.notes.append("Residuals in natural units (weight, reach, g).")


# By name: title and function that draws.
TOPICS: dict[str, tuple[str, Callable[[Sheet], None]]] = {
    "summary": ("summary", draw_summary),
    "limits": ("shares of the limits", joints.draw_limits),
    "joints": ("joints", joints.draw_joints),
    "drives": ("drives", joints.draw_drives),
    "forces": ("contact forces", contacts.draw_forces),
    "soles": ("centres of pressure", contacts.draw_soles),
    "base": ("base", base.draw_base),
    "momentum": ("centre of mass, momentum and power", base.draw_momentum),
    "clearance": ("clearance", base.draw_clearance),
    "accuracy": ("errors between points", accuracy.draw_accuracy),
}


def sheet_of(tracks: Sequence[Track], names: Sequence[str]) -> Sheet:
    """Draw topics of `TOPICS` into one figure; those that do not apply to the robot are left out."""
    with style.look():
        sheet = Sheet(tracks, row_height=LOW_ROW if "summary" in names else ROW)
        for name in names:
            sheet.draw(name, *TOPICS[name])
        if sheet.topics:
            sheet.finish(f"trajopt {installed_version('trajopt')}")
    return sheet


def sheets_of(tracks: Sequence[Track], groups: Sequence[Sequence[str]]) -> list[Sheet]:
    """Draw a figure for each group of topics; raises `InputError` if none applies or a name is unknown."""
    names = [name for group in groups for name in group]
    for name in names:
        if name not in TOPICS:
            raise not_among(TOPICS, name, f"page '{name}' is unknown")
    sheets = [sheet for sheet in (sheet_of(tracks, group) for group in groups) if sheet.topics]
    if not sheets:
        have = sheet_of(tracks, list(TOPICS)).topics
        raise InputError(
            f"the solution has nothing for page {', '.join(names)}", f"allowed: {', '.join(have)}"
        )
    return sheets


# Suffixes of files with one figure, of the summary by default; others have one for every topic.
PICTURES = (".png", ".svg")
DEFAULT_PAGES = dict.fromkeys(PICTURES, ("summary",)) | {
    ending: tuple(TOPICS) for ending in (".pdf", ".html")
}


@dataclass(frozen=True, kw_only=True)
class Plotted:
    """The written file: its path, its size in bytes, and the names of its pages in order."""

    path: Path
    size: int
    pages: tuple[str, ...]


def check_plot(target: Path, endings: Sequence[str]) -> Path:
    """Return the path if a plot can be written there; raises `InputError` if not."""
    if target.suffix.lower() not in endings:
        raise InputError(
            f"cannot plot to {target}: its ending is '{target.suffix}'", f"allowed: {', '.join(endings)}"
        )
    return check_output(target)


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
        solutions: Solutions or their files; the first is drawn with solid lines, shaded phases and points.
        target: Ends with .png, .svg (one picture; default the summary), .pdf (a page for each topic) or
            .html (one file that needs no network; both with all topics).
        labels: A name for each solution.
        pages: Names of `writing.PAGES`; pages that do not apply to the robot are left out.

    Raises:
        InputError: For another suffix, a file that cannot be written, an unknown page, or solutions of
            several robots.
        SolutionFileError: For a file that cannot be read.
    """
    place = check_plot(Path(target), tuple(DEFAULT_PAGES))
    ending = place.suffix.lower()
    read = solutions_of(solutions)
    for one in read:
        if one.n_samples < 2:
            raise InputError(f"the solution has {one.n_samples} samples", "allowed: two or more")
    names = pages or DEFAULT_PAGES[ending]
    with np.errstate(all="ignore"):  # a diverged iterate may overflow
        tracks = tracks_of(read, labels)
        tables = html_tables(tracks) if ending == ".html" else []  # first: figures show what is measured here
        sheets = sheets_of(tracks, [names] if ending in PICTURES else [[name] for name in names])
        content = _content(sheets, tracks, tables, ending)
    with replacing(place) as unfinished:
        unfinished.write_bytes(content)
    return Plotted(
        path=place, size=len(content), pages=tuple(name for sheet in sheets for name in sheet.topics)
    )


def _content(sheets: Sequence[Sheet], tracks: Sequence[Track], tables: Sequence[str], ending: str) -> bytes:
    if ending in PICTURES:
        return style.rendered(sheets[0].figure, ending)
    if ending == ".html":
        return html_page(sheets, tracks, tables).encode()
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    facts = {"Title": title_of(tracks), "Creator": "trajopt", "CreationDate": None}  # for equal files
    with style.look(), PdfPages(buffer, metadata=facts) as document:
        for sheet in sheets:
            document.savefig(sheet.figure)
    return buffer.getvalue()


def check_push_plot(target: Path) -> Path:
    """Return the path if a plot of pushes can be written there; raises `InputError` if not."""
    return check_plot(target, (*PICTURES, ".pdf"))


@checked
def write_push_plot(report: PushReport, target: str | Path) -> Path:
    """Plot the largest pushes of a report by direction, in natural units, with the base's front at the top.

    Args:
        report: from `trajopt.simulation.push.largest_pushes`.
        target: ends with .png, .svg or .pdf.

    Returns:
        The path of the file.

    Raises:
        InputError: for another ending, or a file that cannot be written.
    """
    place = check_push_plot(Path(target))
    content = style.rendered(figure_of_pushes(report), place.suffix.lower())
    with replacing(place) as unfinished:
        unfinished.write_bytes(content)
    return place


def figure_of_pushes(report: PushReport) -> Figure:
    """Draw a closed curve per controller; triangles mark impulses that are only lower bounds."""
    from matplotlib.figure import Figure

    with style.look():
        figure = Figure(figsize=(5.0, 5.4), dpi=style.DOTS, layout="constrained")
        axes = figure.add_subplot(projection="polar")
        axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
        angles = np.radians(report.directions)
        for number, (controller, sizes) in enumerate(report.impulses.items()):
            natural = np.array(sizes) / report.unit
            line = {"color": style.colour(number), "linestyle": style.LINES[number]}
            axes.plot(np.append(angles, angles[:1]), np.append(natural, natural[:1]), label=controller,
                      marker=style.MARKERS[number], markersize=4, **line)  # fmt: skip
            open_ended = np.array(sizes) >= report.most
            axes.plot(angles[open_ended], natural[open_ended], color=style.colour(number), marker="^",
                      linestyle="none", markersize=8)  # fmt: skip
        axes.set_ylim(bottom=0.0)
        axes.set_xticks(angles, [f"{angle:g}\N{DEGREE SIGN}" for angle in report.directions])
        title = style.literal(f"{report.problem} on {report.robot}")
        figure.suptitle(title, fontsize=style.FONT, weight="bold")
        axes.set_xlabel(
            f"largest impulse survived over weight sqrt(l / g) = {report.unit:.3g} N s, "
            f"at {report.time:.3g} s\n0\N{DEGREE SIGN}: forward, counter-clockwise"
        )
        figure.legend(loc="outside lower center", ncols=len(report.impulses))
    return figure
