"""One HTML file: facts, figures of the check and of accuracy as tables, and the pages as SVG."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape

from trajopt.versions import installed_version
from trajopt.view.plotting.facts import FigureTable, failure_of, state_of, title_of
from trajopt.view.plotting.page import PlotPage, Tracks

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


def html_page(
    tracks: Tracks, drawings: Sequence[tuple[PlotPage, bytes]], sections: Sequence[FigureTable]
) -> str:
    """The file's text. ``drawings`` are pages with their SVG, ``sections`` the tables."""
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
