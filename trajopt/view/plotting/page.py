"""The HTML file of a plot: the figures, and tables of the solve, its check and its accuracy."""

from base64 import b64encode
from collections.abc import Sequence
from html import escape

import numpy as np

from trajopt.certify.accuracy.table import accuracy_figures
from trajopt.certify.report import MeasuredFigure
from trajopt.motion.energy_use import cost_of_transport, energy
from trajopt.view.plotting import style
from trajopt.view.plotting.sheet import Sheet
from trajopt.view.plotting.track import Track, failure_of, state_of, status_of, title_of, tried

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
    measured = [accuracy_figures(track.accuracy) if track.accuracy else () for track in tracks]
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
