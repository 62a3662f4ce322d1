"""Polar plot of the largest pushes by direction, with the front of the base at the top."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.simulation.push import PushReport
from trajopt.solution.output import check_output, replacing
from trajopt.view.plotting import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENDINGS = (".png", ".svg", ".pdf")
# Width and height in inches.
SIZE = (5.0, 5.4)


def check_push_plot(target: Path) -> Path:
    """Return the path if a plot can be written there; raises `InputError` if not."""
    if target.suffix.lower() not in ENDINGS:
        raise InputError(
            f"cannot plot to {target}: its ending is '{target.suffix}'", f"allowed: {', '.join(ENDINGS)}"
        )
    return check_output(target)


@checked
def write_push_plot(report: PushReport, target: str | Path) -> Path:
    """Plot the largest pushes of a report, in natural units.

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
        figure = Figure(figsize=SIZE, dpi=style.DOTS, layout="constrained")
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
