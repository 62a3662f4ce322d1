"""Pages about contacts: stance diagram, forces against the friction cone, impulses, soles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.page import (
    LEFT,
    LegendEntry,
    PlotPage,
    PlotPanel,
    PlotRow,
    Tracks,
    batches,
    page_of,
    panel_row,
)
from trajopt.view.plotting.time_axis import impact_times
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Row height of the stance diagram in units of a row's height; height of its bars.
STANCE_ROW, BAR = 0.11, 0.62
# Inches of a letter in the names of contacts.
NAME_LETTER = 0.06
# Panels of contacts side by side; rows of them on a shared page, and on a separate page.
CONTACTS_A_ROW, ROWS_A_PAGE, ROWS_ALONE = 2, 3, 6
NORMAL, TANGENTIAL = style.BLUE, style.RED
CONE = "#d9d9d9"


def contacts(tracks: Tracks) -> list[int]:
    """Contacts that are active at some time in one of the solutions."""
    return [int(i) for i in np.flatnonzero(np.any([t.solution.active.any(axis=0) for t in tracks], axis=0))]


def stance_row(tracks: Tracks) -> PlotRow | None:
    """Which contacts are active in which phase, for every solution."""
    found, frames = contacts(tracks), tracks[0].solution.contact_frames
    if not found:
        return None
    left = max(LEFT, 0.25 + NAME_LETTER * max(len(frames[i]) for i in found))
    height = STANCE_ROW * len(found) * max(1.0, 0.7 * len(tracks))
    stances = partial(_stances, found=found)
    return panel_row("contacts", "contacts", "", stances, height=height, left=left, rigid=True)


def _stances(axes: Axes, tracks: Tracks, found: Sequence[int]) -> None:
    names = [tracks[0].solution.contact_frames[i] for i in found]
    tall = BAR / len(tracks)
    for number, track in enumerate(tracks):
        shade = style.BLACK if number == 0 else style.GREY
        for row, contact in enumerate(found):
            at = row - BAR / 2 + (number + 0.5) * tall
            for start, end in stance_spans(track, contact):
                axes.barh(at, end - start, height=0.9 * tall, left=start, color=shade, linewidth=0)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)


def stance_spans(track: Track, contact: int) -> list[tuple[float, float]]:
    """Start and end, s, of every stretch of intervals in which a contact is active."""
    plan = track.solution
    active = np.array([plan.active[rows.start, contact] for rows in plan.intervals])
    changes = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(int)))
    return [
        (float(plan.interval_t[first, 0]), float(plan.interval_t[stop - 1, 1]))
        for first, stop in zip(changes[::2], changes[1::2], strict=True)
    ]


def normal_row(tracks: Tracks) -> PlotRow:
    """Return normal forces of all contacts."""
    curves = draw.told_apart(tracks, contact_curves(tracks, lambda motion: motion.normal))
    scale = partial(draw.fit, zero=True)
    return draw.curve_row("normal", "normal contact forces", "f\u2099 [N]", curves, scale)


def cone_row(tracks: Tracks) -> PlotRow:
    """Return tangential force over the radius of the friction cone, for all contacts."""
    curves = draw.told_apart(tracks, contact_curves(tracks, lambda motion: motion.cone_share))
    ylabel, edge = "f\u209c / (\u03bc f\u2099) [1]", [("edge", draw.LIMIT)]
    return draw.curve_row("cone", "share of the friction cone", ylabel, curves, draw.share_axis, edge)


def contact_curves(tracks: Tracks, values: MotionQuantity) -> list[Curve]:
    """Return a curve for each contact: ``values`` (K, nc) of a motion."""
    frames = tracks[0].solution.contact_frames
    return draw.numbered((frames[i], draw.column(values, i)) for i in contacts(tracks))


def force_pages(tracks: Tracks) -> list[PlotPage]:
    """Return forces of every contact with its cone, all in the plane of the cone, impulses, loads."""
    title = "contact forces"
    if not contacts(tracks):
        return page_of("forces", title, [_load_row(tracks)])
    rows = _force_rows(tracks)
    last = [cone_row(tracks), plane_row(tracks), _impulse_row(tracks), _load_row(tracks)]
    note = (
        "Shaded: tangential forces within the friction cone. Dotted red: impacts. "
        "Forces of carried bodies are left out."
    )
    if len(rows) <= ROWS_A_PAGE:
        return page_of("forces", title, [stance_row(tracks), *rows, *last], note=note)
    first, more = rows[:ROWS_ALONE], rows[ROWS_ALONE:]
    return page_of("forces", title, [stance_row(tracks), *first], more, last, note=note)


def _force_rows(tracks: Tracks) -> list[PlotRow]:
    tangential = {"color": TANGENTIAL, "linewidth": 0.9, "marker": "s", **draw.marker_look(TANGENTIAL)}
    legend: tuple[LegendEntry, ...] = (
        ("normal f\u2099", {"color": NORMAL}),
        ("tangential f\u209c", tangential),
        ("cone, f\u209c \u2264 \u03bc f\u2099", {"color": CONE, "linewidth": 5}),
    )
    frames = tracks[0].solution.contact_frames
    panels = [
        PlotPanel(name=f"force:{frames[i]}", ylabel=f"{frames[i]} f [N]", draw=partial(_force, contact=i))
        for i in contacts(tracks)
    ]
    rows = [PlotRow(title="", panels=tuple(part), height=1.1) for part in batches(panels, CONTACTS_A_ROW)]
    return [replace(rows[0], title="contact forces", legend=legend), *rows[1:]]


def _force(axes: Axes, tracks: Tracks, contact: int) -> None:
    t, cone = tracks[0].curve(lambda motion: motion.cone[:, contact])
    axes.fill_between(t, 0.0, np.maximum(cone, 0.0), color=CONE, linewidth=0, zorder=1, antialiased=False)
    normal = Curve(label="normal", values=lambda m: m.normal[:, contact], number=0, marked=False)
    tangential = Curve(label="tangential", values=lambda m: m.tangential[:, contact], number=1, width=0.9)
    draw.curves(axes, tracks, [normal, tangential])
    draw.fit(axes, zero=True)


def plane_row(tracks: Tracks) -> PlotRow:
    """Return tangential over normal force: the friction cone seen from the side, by contact."""
    drawn = draw.told_apart(tracks, contact_curves(tracks, lambda motion: motion.normal))
    title, ylabel = "tangential over normal force", "tangential force f\u209c [N]"
    edge = f"edge of the cone, \u03bc = {', '.join(f'{slope:.3g}' for slope in _slopes(tracks[0]))}"
    legend = (*(curve.entry for curve in drawn), (edge, draw.LIMIT))
    plane = partial(_plane, drawn=drawn)
    return panel_row(title, "plane", ylabel, plane, timed=False, legend=legend, height=1.7)


def _plane(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    across = [curve.values for curve in contact_curves(tracks, lambda motion: motion.tangential)]
    for number, track in enumerate(tracks):
        for curve, tangential in zip(drawn, across, strict=True):
            x, y = track.pair(curve.values, tangential)
            axes.plot(
                x,
                y,
                color=curve.colour,
                linestyle=draw.line_of(tracks, curve, number),
                linewidth=curve.width,
                marker=curve.marker,
                markevery=max(1, len(x) // 8),
                label=f"{curve.label}/{track.label}",
                **draw.marker_look(curve.colour),
            )
    draw.fit(axes, zero=True)
    motion = tracks[0].dense
    normal = np.where(np.isfinite(motion.normal), motion.normal, 0.0)
    most = float(normal.max(initial=1e-9))
    slopes = _slopes(tracks[0])
    edge = np.array([0.0, 1.05 * most])
    axes.set_xlim(min(0.0, float(normal.min(initial=0.0))), edge[1])
    for slope in slopes:
        axes.plot(edge, slope * edge, **draw.LIMIT)
        axes.fill_between(edge, 0.0, slope * edge, color=CONE, alpha=0.5, linewidth=0, zorder=0)
    axes.set_ylim(0.0, 1.05 * float(slopes.max(initial=0.1)) * most)
    axes.set_xlabel("normal force f\u2099 [N]", labelpad=1.0)


def _slopes(track: Track) -> np.ndarray:
    """The different coefficients of friction of the active contacts."""
    motion = track.dense
    return np.unique(np.round(motion.surfaces.friction[motion.solution.active], 9))


def impulses_of(track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal and tangential impulses (J, nc) N s of a solution's impacts, and mu times the normal ones."""
    plan = track.solution
    if plan.impulse is None or plan.impact_index is None:
        empty = np.zeros((0, len(plan.contact_frames)))
        return empty, empty, empty
    surfaces, rows = track.points.surfaces, plan.impact_index
    normal = surfaces.normal[rows]
    along = np.sum(normal * plan.impulse[..., :3], axis=-1)
    across = np.linalg.norm(plan.impulse[..., :3] - along[..., None] * normal, axis=-1)
    return along, across, surfaces.friction[rows] * along


def _impulse_row(tracks: Tracks) -> PlotRow | None:
    if not any(impact_times(track) for track in tracks):
        return None
    looks = {"normal": (NORMAL, "o"), "tangential": (TANGENTIAL, "s"), "\u03bc normal": (style.BLACK, "_")}
    legend = tuple(
        (label, {"color": colour, "marker": marker, "linestyle": "none"})
        for label, (colour, marker) in looks.items()
    )
    title, ylabel = "impulses of the impacts", "impulse \u039b [N s]"
    return panel_row(title, "impulses", ylabel, _impulses, timed=False, legend=legend)


def _impulses(axes: Axes, tracks: Tracks) -> None:
    names: list[str] = []
    for track in tracks:
        normal, tangential, cone = impulses_of(track)
        for impact, time in enumerate(impact_times(track)):
            for contact in np.flatnonzero(normal[impact]):
                at = len(names)
                axes.plot([at, at], [0.0, normal[impact, contact]], color=NORMAL, linewidth=0.9)
                axes.plot(at, normal[impact, contact], "o", color=NORMAL, markersize=4, label="normal/")
                axes.plot(at, tangential[impact, contact], "s", color=TANGENTIAL, markersize=4)
                axes.plot(at, cone[impact, contact], "_", color=style.BLACK, markersize=10)
                which = f"{style.literal(style.short(track.label))}\n" if len(tracks) > 1 else ""
                names.append(f"{which}{track.solution.contact_frames[contact]}\n{time:.3f} s")
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", labelsize=6)
    axes.set_xlim(-0.5, max(len(names), 6) - 0.5)
    axes.set_ylim(bottom=0.0)
    axes.margins(y=0.1)


def _load_row(tracks: Tracks) -> PlotRow | None:
    if not tracks[0].meta.get("payloads"):
        return None
    load = Curve(label="magnitude", values=lambda motion: motion.load)
    title, scale = "force of carried bodies on the robot", partial(draw.fit, zero=True)
    return replace(draw.curve_row("load", title, "force |f| [N]", [load], scale, height=1.2), legend=())
