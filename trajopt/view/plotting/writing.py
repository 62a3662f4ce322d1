"""A report of one or several solutions, as pictures, a document to print, or one HTML file."""

import io
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError, not_among
from trajopt.solution.input import solutions_of
from trajopt.solution.output import check_output, replacing
from trajopt.solution.solution import Solution
from trajopt.versions import installed_version
from trajopt.view.plotting import style
from trajopt.view.plotting import topics_accuracy as accuracy
from trajopt.view.plotting import topics_base as base
from trajopt.view.plotting import topics_contacts as contacts
from trajopt.view.plotting import topics_joints as joints
from trajopt.view.plotting import topics_limits as limits
from trajopt.view.plotting.draw import PlotPage, PlotRow, Tracks, page_of
from trajopt.view.plotting.figure import figure_of
from trajopt.view.plotting.topics_contacts import sole_pages
from trajopt.view.plotting.track import FigureTable, failure_of, sections, state_of, title_of, tracks_of

# Most rows of a map of shares in the summary: with more joints, one row per limb.
MAP_ROWS = 12
# Most limbs whose curves the summary of an arm shows.
FEW_LIMBS = 2


def summary_pages(tracks: Tracks) -> list[PlotPage]:
    """Contacts, shares of limits, base or joints, forces, momentum or power, errors: one page."""
    shares = _shares(tracks)
    is_map = shares is not None and len(tracks) == 1
    rows: list[PlotRow | None] = [contacts.stance_row(tracks), shares]
    moving = base.has_base(tracks)
    if moving:
        rows += [joints.torque_row(tracks), base.thrust_row(tracks)]
        rows += [base.vector_row(tracks, name) for name in ("base position", "base orientation")]
    else:
        limbs = joints.limbs(tracks)
        alone = len(limbs) == 1
        for limb in limbs[:FEW_LIMBS]:
            rows += joints.limb_rows(tracks, limb, wide=alone, alone=alone)
    if contacts.contacts(tracks):
        rows += [contacts.normal_row(tracks), contacts.cone_row(tracks)]
    if moving:
        rows.append(base.vector_row(tracks, "angular momentum"))
    rows += [base.clearance_row(tracks), base.power_row(tracks), accuracy.residual_row(tracks)]
    maps = "Maps: share of the limit that is used, on the right its largest in per cent; orange: beyond it. "
    note = f"{maps if is_map else ''}Residuals in natural units (weight, reach, g)."
    return page_of("summary", "summary", rows, note=note)


def _shares(tracks: Tracks) -> PlotRow | None:
    """A map of the shares of limits of one solution; of several, curves of their largest shares."""
    rows, names = limits.axes_and_names(tracks)
    if not rows or len(tracks) > 1:
        return limits.largest_row(tracks) if rows else None
    groups = [[axis] for axis in rows]
    if len(rows) > MAP_ROWS:
        limbs = joints.limbs(tracks)
        groups, names = [list(limb.axes) for limb in limbs], [limb.name for limb in limbs]
    return limits.map_row(tracks, 0, groups, names)


PAGES: dict[str, Callable[[Tracks], list[PlotPage]]] = {
    "summary": summary_pages,
    "limits": limits.limit_pages,
    "joints": joints.joint_pages,
    "drives": joints.drive_pages,
    "forces": contacts.force_pages,
    "soles": sole_pages,
    "base": base.base_pages,
    "momentum": base.momentum_pages,
    "clearance": base.clearance_pages,
    "accuracy": accuracy.accuracy_pages,
}


def pages_of(tracks: Tracks, names: Sequence[str]) -> list[PlotPage]:
    """Pages by name, in this order; those that do not apply to the robot are left out.

    Raises `InputError` for an unknown name, or if none is left.
    """
    for name in names:
        if name not in PAGES:
            raise not_among(PAGES, name, f"page '{name}' is unknown")
    chosen = [page for name in names for page in PAGES[name](tracks)]
    if not chosen:
        have = [name for name, pages in PAGES.items() if pages(tracks)]
        raise InputError(
            f"the solution has nothing for page {', '.join(names)}", f"allowed: {', '.join(have)}"
        )
    return chosen


# Default pages by suffix: a picture has the summary, a document all pages.
DEFAULT_PAGES = {".png": ("summary",), ".svg": ("summary",), ".pdf": tuple(PAGES), ".html": tuple(PAGES)}
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
footer { color: #555; font-size: .8rem; margin-top: 2rem; }
@media print { nav { display: none; } body { max-width: none; padding: 0; font-size: 10pt; }
  figure { break-before: page; margin: 0; overflow: visible; } figure img { min-width: 0; max-height: 277mm; }
  @page { size: A4; margin: 10mm; } }
"""


@dataclass(frozen=True, kw_only=True)
class Plotted:
    """The written file: its path, its size in bytes, and the names of its pages in order."""

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
        solutions: Solutions or their files; the first is drawn with solid lines, shaded phases and points.
        target: Ends with .png, .svg (one picture; default the summary page), .pdf (A4 pages) or .html (one
            file that needs no network; both with all pages).
        labels: A name for each solution.
        pages: Names of `writing.PAGES`; pages that do not apply to the robot are left out.

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


def html_page(
    tracks: Tracks, drawings: Sequence[tuple[PlotPage, bytes]], sections: Sequence[FigureTable]
) -> str:
    """The text of the page; ``drawings`` are pages with their SVG, ``sections`` the tables."""
    title, links, figures = escape(title_of(tracks)), [], []
    labelled = [(f"{track.label}: " if len(tracks) > 1 else "", track) for track in tracks]
    head = [f'<p class="state">{escape(label + state_of(track))}</p>' for label, track in labelled]
    head += [
        f'<p class="warning">{escape(label + failure)}</p>'
        for label, track in labelled
        if (failure := failure_of(track))
    ]
    names = [page.name for page, _ in drawings]
    for number, (page, svg) in enumerate(drawings):
        nth = f" {names[: number + 1].count(page.name)}" if names.count(page.name) > 1 else ""
        anchor, text = (page.name + nth).replace(" ", "-"), escape(page.title + nth)
        links.append(f'<a href="#{anchor}">{text}</a>')
        source = f"data:image/svg+xml;base64,{b64encode(svg).decode()}"
        figures.append(f'<figure id="{anchor}"><img alt="{text}" src="{source}"></figure>')
    tables = [_table(section, [track.label for track in tracks]) for section in sections]
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
            f"<footer>trajopt {escape(installed_version('trajopt'))}</footer></body></html>",
            "",
        ]
    )


def _table(section: FigureTable, labels: Sequence[str]) -> str:
    judged = any(allowed for *_, allowed in section.rows)
    names = labels if len(labels) > 1 else [""]
    heads = "".join(f'<th class="number">{escape(name)}</th>' for name in names)
    rows = [f"<h2>{escape(section.title)}</h2><table>"]
    if len(labels) > 1 or judged:
        rows.append(f"<tr><th></th>{heads}<th>unit</th>{'<th>tolerance</th>' if judged else ''}</tr>")
    for number, (name, values, unit, allowed) in enumerate(section.rows):
        cells = "".join(
            f'<td class="number{" beyond" if (number, i) in section.beyond else ""}">{escape(value)}</td>'
            for i, value in enumerate(values)
        )
        tolerance = f'<td class="unit">{escape(allowed)}</td>' if judged else ""
        rows.append(f'<tr><td>{escape(name)}</td>{cells}<td class="unit">{escape(unit)}</td>{tolerance}</tr>')
    return "\n".join([*rows, "</table>"])
