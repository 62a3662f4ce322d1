"""The page about soles: their centres of pressure, seen from above and over time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of
from trajopt.view.plotting.topics_contacts import CONTACTS_A_ROW, contact_curves, contacts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Range shown around a sole, over its size.
AROUND = 1.3


def sole_pages(tracks: Tracks) -> list[PlotPage]:
    """Centres of pressure in the soles, seen from above and over time."""
    described = tracks[0].solution.description.contacts
    sizes = {i: described[i].half_size for i in contacts(tracks) if described[i].is_sole}
    soles = {i: size for i, size in sizes.items() if size is not None}
    if not any(np.isfinite(track.dense.pressure_centre[:, list(soles)]).any() for track in tracks):
        return []
    panels = []
    for i, half in soles.items():
        drawing, frame = partial(_sole, contact=i, half=half), described[i].frame
        panels.append(PlotPanel(name=f"sole:{frame}", ylabel="y [m]", draw=drawing, title=frame))
    above = batches(panels, CONTACTS_A_ROW)
    rows = [PlotRow(panels=part, timed=False, legend=False, height=1.3, rigid=True) for part in above]
    for axis, word in enumerate(("along (x)", "across (y)")):
        half_sizes = np.array([soles[i][axis] if i in soles else np.nan for i in range(len(described))])
        drawn = contact_curves(tracks, partial(_pressure_share, axis=axis, half=half_sizes))
        drawn = [curve for curve, i in zip(drawn, contacts(tracks), strict=True) if i in soles]
        title = f"centre of pressure {word}, over the sole's half size"
        rows.append(draw.curve_row(f"pressure:{axis}", title, "offset / half size [1]", drawn, _fit_sole))
    note = "Centre of pressure in the sole's own axes; the frame is its edge. Dots darken with time."
    return page_of("soles", "centres of pressure", rows, note=note)


def _pressure_share(motion: MotionQuantities, axis: int, half: np.ndarray) -> np.ndarray:
    return np.asarray(motion.pressure_centre[..., axis] / half)


def _fit_sole(axes: Axes) -> None:
    low, high = draw.fit(axes)
    draw.set_range(axes, min(-1.0, low), max(1.0, high))
    for edge in (-1.0, 1.0):
        axes.axhline(edge, **draw.LIMIT)


def _sole(axes: Axes, tracks: Tracks, contact: int, half: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    length, width = half
    axes.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, linewidth=1.0))
    motion = tracks[0].dense
    x, y = motion.pressure_centre[:, contact].T
    shown = np.isfinite(x)
    axes.scatter(x[shown], y[shown], c=motion.t[shown], s=5, cmap=style.TIMES, linewidths=0, zorder=3)
    along, across = (draw.column(lambda motion: motion.pressure_centre[:, contact], i) for i in (0, 1))
    for number, track in enumerate(tracks):
        look = {"color": style.GREY, "linewidth": 0.6, "linestyle": style.line_style(number)}
        axes.plot(*track.pair(along, across), label="pressure", **look)
    axes.set(xlim=(-AROUND * length, AROUND * length), ylim=(-AROUND * width, AROUND * width))
    axes.set_aspect("equal", anchor="NW")
    axes.set_xlabel("x [m]")
