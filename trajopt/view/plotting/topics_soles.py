"""The page about soles: where in them the pressure acts, seen from above and over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.certify.contact_figures import is_sole
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.motion import Motion
from trajopt.view.plotting.page import BETWEEN, LEFT, RIGHT, UNIT, Page, Panel, Row, Tracks
from trajopt.view.plotting.topics_contacts import CONTACTS_A_ROW, contacts, each

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# What is shown around a sole, over its size; the largest height of its panel in inches.
AROUND, TALLEST = 1.3, 2.6


def sole_pages(tracks: Tracks) -> list[Page]:
    """Centres of pressure in the soles, seen from above and over time."""
    sizes = tracks[0].meta.get("contact_sizes") or []
    soles = [
        i for i in contacts(tracks) if i < len(sizes) and sizes[i] and bool(is_sole(tracks[0].solution)[i])
    ]
    if not any(np.isfinite(track.dense.pressure_centre[:, soles]).any() for track in tracks):
        return []
    frames, rows = tracks[0].solution.contact_frames, []
    for start in range(0, len(soles), CONTACTS_A_ROW):
        part = soles[start : start + CONTACTS_A_ROW]
        panels = tuple(
            Panel(
                name=f"sole:{frames[i]}",
                ylabel="y [m]",
                draw=partial(_sole, contact=i),
                timed=False,
                title=frames[i],
            )
            for i in part
        )
        rows.append(Row(title="", panels=panels, height=_height(sizes[part[0]]), rigid=True))
    for axis, word in enumerate(("along (x)", "across (y)")):
        drawn = each(tracks, partial(_pressure_share, axis=axis, sizes=sizes))
        drawn = [curve for curve, i in zip(drawn, contacts(tracks), strict=True) if i in soles]
        panel = Panel(
            name=f"pressure:{axis}", ylabel="offset / half size [1]", draw=partial(_pressure, drawn=drawn)
        )
        title = f"centre of pressure {word}, over the sole's half size"
        rows.append(Row(title=title, panels=(panel,), legend=tuple(curve.entry for curve in drawn)))
    note = "Centre of pressure in the sole's own axes; the frame is its edge. Dots darken with time."
    return [Page(name="soles", title="centres of pressure", rows=tuple(rows), note=note)]


def _height(size: Sequence[float]) -> float:
    """Height of a sole's panel, in units of a row's, that leaves its two axes one scale."""
    length, width = size
    inches = (style.WIDTH - LEFT - RIGHT - BETWEEN) / CONTACTS_A_ROW * width / length
    return min(inches, TALLEST) / UNIT


def _pressure_share(motion: Motion, contact: int, axis: int, sizes: Sequence[Sequence[float]]) -> np.ndarray:
    return np.asarray(motion.pressure_centre[:, contact, axis] / sizes[contact][axis])


def _pressure(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn)
    low, high = draw.fit(axes)
    draw.room(axes, min(-1.0, low), max(1.0, high))
    for edge in (-1.0, 1.0):
        axes.axhline(edge, color=style.BLACK, linewidth=0.8, linestyle=draw.LIMIT_DASHES)


def _sole(axes: Axes, tracks: Tracks, contact: int) -> None:
    from matplotlib.patches import Rectangle

    length, width = tracks[0].meta["contact_sizes"][contact]
    axes.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, linewidth=1.0))
    for number, track in enumerate(tracks):
        if number == 0:
            x, y = track.dense.pressure_centre[:, contact].T
            shown = np.isfinite(x)
            axes.scatter(
                x[shown], y[shown], c=track.dense.t[shown], s=5, cmap=style.TIMES, linewidths=0, zorder=3
            )
        along, across = (partial(_pressure_at, contact=contact, axis=axis) for axis in (0, 1))
        look = {"color": style.GREY, "linewidth": 0.6, "linestyle": style.LINES[number % len(style.LINES)]}
        axes.plot(*track.pair(along, across), label=f"pressure/{track.label}", **look)
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlim(-AROUND * length, AROUND * length)
    axes.set_ylim(-AROUND * width, AROUND * width)
    axes.set_xlabel("x [m]", labelpad=1.0)


def _pressure_at(motion: Motion, contact: int, axis: int) -> np.ndarray:
    return np.asarray(motion.pressure_centre[:, contact, axis])
