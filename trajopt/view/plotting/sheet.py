"""Pages below one another as one picture."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS_AN_INCH = 72
# Consecutive marks of one kind, more than a curve has markers: dots at collocation points.
USE = r'<use xlink:href="#(m\w+)" x="([-\d.]+)" y="([-\d.]+)" style="fill: (#\w+)[^"]*"/>\s*'
RUN = re.compile(r'<use xlink:href="#(m\w+)" [^>]*/>\s*(?:<use xlink:href="#\1" [^>]*/>\s*){11,}')


def svg_of(figure: Figure) -> str:
    """A figure as SVG, without the head of a file."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": style.RC["svg.fonttype"], "svg.hashsalt": style.RC["svg.hashsalt"]}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return shorten_svg(text[text.index("<svg") :])


def png_sheet(figures: Sequence[Figure]) -> bytes:
    """Figures of one width below one another as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    pictures, buffer = [], io.BytesIO()
    for canvas in map(FigureCanvasAgg, figures):
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3])
    imsave(buffer, np.concatenate(pictures), format="png", dpi=style.DOTS)
    return buffer.getvalue()


def svg_sheet(figures: Sequence[Figure]) -> str:
    """Draw figures of one width below one another as one SVG file."""
    heights = [figure.get_size_inches()[1] * POINTS_AN_INCH for figure in figures]
    width, total = style.WIDTH * POINTS_AN_INCH, sum(heights)
    head = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    parts = [
        f'{head} width="{width:g}pt" height="{total:g}pt" viewBox="0 0 {width:g} {total:g}" version="1.1">'
    ]
    at = 0.0
    for number, (figure, height) in enumerate(zip(figures, heights, strict=True)):
        parts.append(f'<g transform="translate(0 {at:g})">{with_unique_ids(svg_of(figure), number)}</g>')
        at += height
    return "\n".join([*parts, "</svg>", ""])


def shorten_svg(svg: str) -> str:
    """The drawing with coordinates of paths and marks rounded to a hundredth of a point."""
    svg = RUN.sub(_dots, svg)
    places = re.compile(r'(?<=[ "])(?:d|x|y|points)="[^"]*"')
    return places.sub(lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), svg)


def _dots(run: re.Match[str]) -> str:
    """Dots as one path of points with round ends, a tenth of the size; other marks stay."""
    marks = re.findall(USE, run[0])
    if len(marks) != run[0].count("<use") or len({mark[3] for mark in marks}) > 1:
        return run[0]
    path = "".join(f"M{x} {y}h0" for _, x, y, _ in marks)
    look = f"fill: none; stroke: {marks[0][3]}; stroke-width: {style.DOT}; stroke-linecap: round"
    return f'<path d="{path}" style="{look}"/>\n'


def with_unique_ids(svg: str, number: int) -> str:
    """The drawing with element ids that are unique in the file."""
    named = re.sub(r'\bid="([^"]+)"', rf'id="p{number}-\1"', svg)
    named = re.sub(r'(xlink:href|href)="#([^"]+)"', rf'\1="#p{number}-\2"', named)
    return re.sub(r"url\(#([^)]+)\)", rf"url(#p{number}-\1)", named)
