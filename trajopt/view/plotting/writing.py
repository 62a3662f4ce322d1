"""A report of one or several solutions, as pictures, a document to print, or one HTML file."""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajopt.arguments import checked
from trajopt.certify.figures import MeasuredFigure
from trajopt.errors import InputError, not_among
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.motion.input import solutions_of
from trajopt.motion.output import check_output, replacing
from trajopt.motion.solution import Solution
from trajopt.simulation.push import PushReport
from trajopt.versions import installed_version
from trajopt.view.plotting import style
from trajopt.view.plotting import topics_accuracy as accuracy
from trajopt.view.plotting import topics_base as base
from trajopt.view.plotting import topics_contacts as contacts
from trajopt.view.plotting import topics_joints as joints
from trajopt.view.plotting.sheet import LOW_ROW, ROW, Sheet
from trajopt.view.plotting.track import Track, failure_of, state_of, status_of, title_of, tracks_of, tried

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
    """Draw a figure for each group of topics; raises `InputError` if none applies."""
    sheets = [sheet for sheet in (sheet_of(tracks, group) for group in groups) if sheet.topics]
    if not sheets:
        names = ", ".join(name for group in groups for name in group)
        have = sheet_of(tracks, list(TOPICS)).topics
        raise InputError(f"the solution has nothing for page {names}", f"allowed: {', '.join(have)}")
    return sheets


STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.45 system-ui, sans-serif; color: #111; background: #fff; margin: 0 auto;
  max-width: 1000px; padding: 1.5rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem; }
p.state { color: #555; margin: 0; } p.warning { color: #b34400; font-weight: bold; margin: .3rem 0; }
nav { margin: .8rem 0 1.2rem; } nav a { margin-right: 1rem; color: #0072b2; }
figure { margin: 1.2rem 0; overflow-x: auto; } figure img { width: 100%; height: auto; min-width: 640px; }
table { border-collapse: collapse; font-size: .85rem; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .15rem .8rem .15rem 0;
  border-bottom: 1px solid #e3e3e3; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
td.beyond { color: #b34400; font-weight: bold; } td.unit { color: #555; white-space: nowrap; }
@media print { nav { display: none; } body { max-width: none; padding: 0; font-size: 10pt; }
  figure { break-before: page; margin: 0; overflow: visible; } figure img { min-width: 0; max-height: 277mm; }
  @page { size: A4; margin: 10mm; } }
"""
# Units of those facts that have one.
UNITS = {
    "largest violation": "scaled",
    "phases": "s",
    "duration": "s",
    "time of the solver": "s",
    "energy drawn by joints": "J",
    "cost of transport": "1",
}
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
        pages: Names of `TOPICS`; pages that do not apply to the robot are left out.

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
    names = list(dict.fromkeys(pages or DEFAULT_PAGES[ending]))
    for name in names:
        if name not in TOPICS:
            raise not_among(TOPICS, name, f"page '{name}' is unknown")
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


def html_page(sheets: Sequence[Sheet], tracks: Sequence[Track], tables: Sequence[str]) -> str:
    """The text of the page, with figures as SVG and the tables of `html_tables`."""
    title, links, figures = escape(title_of(tracks)), [], []
    labelled = [(f"{track.label}: " if len(tracks) > 1 else "", track) for track in tracks]
    head = [f'<p class="state">{escape(label + state_of(track))}</p>' for label, track in labelled]
    head += [
        f'<p class="warning">{escape(label + failure)}</p>'
        for label, track in labelled
        if (failure := failure_of(track))
    ]
    for sheet in sheets:
        ((name, text),) = sheet.topics.items()
        links.append(f'<a href="#{name}">{text}</a>')
        svg = b64encode(style.rendered(sheet.figure, ".svg")).decode()
        figures.append(
            f'<figure id="{name}"><img alt="{text}" src="data:image/svg+xml;base64,{svg}"></figure>'
        )
    further = '<a href="#figures">check and accuracy</a>' if tables[1:] else ""
    return "\n".join(
        [
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}</title><style>{STYLE}</style></head><body>",
            f"<h1>{title}</h1>",
            *head,
            f"<nav>{''.join(links)}{further}</nav>",
            f'<section id="facts">{tables[0]}</section>',
            *figures,
            f'<section id="figures">{"".join(tables[1:])}</section>' if tables[1:] else "",
            "</body></html>",
            "",
        ]
    )


def html_tables(tracks: Sequence[Track]) -> list[str]:
    """Tables of the solutions: facts, check and accuracy; missing figures are left empty."""
    facts = [_facts_of(track) for track in tracks]
    rows = [
        _row(name, [of[name] for of in facts], UNITS.get(name, ""))
        for name in facts[0]
        if any(of[name] for of in facts)
    ]
    reports = [track.report.figures() if track.report else () for track in tracks]
    measured = [track.accuracy.figures() if track.accuracy else () for track in tracks]
    names = [track.label for track in tracks] if len(tracks) > 1 else []
    tables = [_table("solution", rows, names)]
    if any(reports):
        judged = _figure_rows(reports, judged=True)
        tables.append(_table("check, by numeric Pinocchio alone", judged, names or [""], judged=True))
    if any(measured):
        tables.append(_table("accuracy between points and in open loop", _figure_rows(measured), names))
    return tables


def _figure_rows(measured: Sequence[Sequence[MeasuredFigure]], *, judged: bool = False) -> list[str]:
    """A row for each figure that is known of one of the solutions."""
    by_text = [{figure.text: figure for figure in figures} for figures in measured]
    rows = []
    for text, one in {text: one for figures in by_text for text, one in figures.items()}.items():
        each = [figures.get(text) for figures in by_text]
        values = ["" if figure is None else f"{figure.value:.3g}" for figure in each]
        bound = "" if one.limit is None else f"{'≥' if one.lower else '≤'} {one.limit:.0e}"
        beyond = [figure is not None and figure.beyond for figure in each]
        rows.append(_row(text, values, one.unit, bound if judged else None, beyond))
    return rows


def _facts_of(track: Track) -> dict[str, str]:
    plan, description, statistics = track.solution, track.solution.description, track.solution.statistics
    drawn = tried(lambda: float(energy(plan))) if track.is_finite else None
    transport = tried(lambda: float(cost_of_transport(plan))) if track.is_finite else None
    solved = "solved" if statistics.success else "NOT SOLVED"
    return {
        "problem": description.problem,
        "robot": description.robot,
        "parameters": ", ".join(f"{key} {_value(entry)}" for key, entry in description.parameters.items()),
        "status": f"{solved}: {status_of(track)}",
        "advice": "" if statistics.success else statistics.advice_in_line,
        "solver": f"{statistics.solver}, tolerance {statistics.tolerance:g}",
        "iterations": str(statistics.iterations),
        "objective": _value(statistics.objective),
        "largest violation": _value(statistics.max_violation),
        "variables, constraints": f"{statistics.variables}, {statistics.constraints}"
        if statistics.variables
        else "",
        "transcription": f"{statistics.transcription}, {plan.n_intervals} intervals",
        "phases": ", ".join(f"{phase.name} {phase.end - phase.start:.3g}" for phase in track.phases),
        "duration": f"{plan.t[-1] - plan.t[0]:.4g}",
        "time of the solver": _value(statistics.wall_time_s),
        "energy drawn by joints": _value(drawn),
        "cost of transport": _value(transport if transport is not None and np.isfinite(transport) else None),
        "versions": ", ".join(f"{key} {entry}" for key, entry in statistics.versions.items()),
    }


def _value(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _row(
    name: str, values: Sequence[str], unit: str, allowed: str | None = None, beyond: Sequence[bool] = ()
) -> str:
    marks = [" beyond" if failed else "" for failed in beyond or [False] * len(values)]
    cells = "".join(
        f'<td class="number{mark}">{escape(value)}</td>' for value, mark in zip(values, marks, strict=True)
    )
    tolerance = f'<td class="unit">{escape(allowed)}</td>' if allowed is not None else ""
    return f'<tr><td>{escape(name)}</td>{cells}<td class="unit">{escape(unit)}</td>{tolerance}</tr>'


def _table(title: str, rows: Sequence[str], names: Sequence[str], *, judged: bool = False) -> str:
    """A table with its title, and with heads if there are ``names`` of columns."""
    heads = [f'<th class="number">{escape(name)}</th>' for name in names]
    tolerance = "<th>tolerance</th>" if judged else ""
    head = [f"<tr><th></th>{''.join(heads)}<th>unit</th>{tolerance}</tr>"] if heads else []
    return "\n".join([f"<h2>{escape(title)}</h2><table>", *head, *rows, "</table>"])


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
