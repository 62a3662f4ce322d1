"""The page about soles: their centres of pressure, seen from above and over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import (
    BETWEEN,
    LEFT,
    RIGHT,
    UNIT,
    PlotPage,
    PlotPanel,
    PlotRow,
    Tracks,
    batches,
    page_of,
)
from trajopt.view.plotting.topics_contacts import CONTACTS_A_ROW, contact_curves, contacts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Range shown around a sole, over its size; the largest height of its panel in inches.
AROUND, TALLEST = 1.3, 2.6


def sole_pages(tracks: Tracks) -> list[PlotPage]:
    """Centres of pressure in the soles, seen from above and over time."""
    sizes = tracks[0].meta.get("contact_sizes") or []
    soles = [
        i for i in contacts(tracks) if i < len(sizes) and sizes[i] and tracks[0].solution.description.soles[i]
    ]
    if not any(np.isfinite(track.dense.pressure_centre[:, soles]).any() for track in tracks):
        return []
    frames = tracks[0].solution.contact_frames
    rows = []
    for part in batches(soles, CONTACTS_A_ROW):
        panels = tuple(
            PlotPanel(
                name=f"sole:{frames[i]}",
                ylabel="y [m]",
                draw=partial(_sole, contact=i),
                timed=False,
                title=frames[i],
            )
            for i in part
        )
        rows.append(PlotRow(title="", panels=panels, height=_height(sizes[part[0]]), rigid=True))
    for axis, word in enumerate(("along (x)", "across (y)")):
        half = np.array([size[axis] if size else np.nan for size in sizes])
        drawn = contact_curves(tracks, partial(_pressure_share, axis=axis, half=half))
        drawn = [curve for curve, i in zip(drawn, contacts(tracks), strict=True) if i in soles]
        title = f"centre of pressure {word}, over the sole's half size"
        ylabel = "offset / half size [1]"
        rows.append(draw.curve_row(f"pressure:{axis}", title, ylabel, drawn, _fit_sole))
    note = "Centre of pressure in the sole's own axes; the frame is its edge. Dots darken with time."
    return page_of("soles", "centres of pressure", rows, note=note)


def _height(size: Sequence[float]) -> float:
    """Height of a sole's panel, in units of a row's, with equal scales on its two axes."""
    length, width = size
    inches = (style.WIDTH - LEFT - RIGHT - BETWEEN) / CONTACTS_A_ROW * width / length
    return min(inches, TALLEST) / UNIT


def _pressure_share(motion: MotionQuantities, axis: int, half: np.ndarray) -> np.ndarray:
    return np.asarray(motion.pressure_centre[..., axis] / half)


def _fit_sole(axes: Axes) -> None:
    low, high = draw.fit(axes)
    draw.set_range(axes, min(-1.0, low), max(1.0, high))
    for edge in (-1.0, 1.0):
        axes.axhline(edge, **draw.LIMIT)


def _sole(axes: Axes, tracks: Tracks, contact: int) -> None:
    from matplotlib.patches import Rectangle

    length, width = tracks[0].meta["contact_sizes"][contact]
    axes.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, linewidth=1.0))
    motion = tracks[0].dense
    x, y = motion.pressure_centre[:, contact].T
    shown = np.isfinite(x)
    axes.scatter(x[shown], y[shown], c=motion.t[shown], s=5, cmap=style.TIMES, linewidths=0, zorder=3)
    along, across = (draw.column(lambda motion: motion.pressure_centre[:, contact], i) for i in (0, 1))
    for number, track in enumerate(tracks):
        look = {"color": style.GREY, "linewidth": 0.6, "linestyle": style.line_style(number)}
        axes.plot(*track.pair(along, across), label=f"pressure/{track.label}", **look)
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlim(-AROUND * length, AROUND * length)
    axes.set_ylim(-AROUND * width, AROUND * width)
    axes.set_xlabel("x [m]", labelpad=1.0)
