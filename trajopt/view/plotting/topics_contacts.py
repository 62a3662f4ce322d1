"""Pages about contacts: stance diagram, forces against the friction cone, impulses, soles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import (
    Curve,
    PlotPage,
    PlotPanel,
    PlotRow,
    Tracks,
    batches,
    page_of,
    panel_row,
)
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Row height of the stance diagram in units of a row's height; height of its bars.
STANCE_ROW, BAR = 0.11, 0.62
# Panels of contacts side by side; rows of them on a shared page, and on a separate page.
CONTACTS_A_ROW, ROWS_A_PAGE, ROWS_ALONE = 2, 3, 6
NORMAL, TANGENTIAL = "normal f\u2099", "tangential f\u209c"
CONE = "#d9d9d9"
# Range shown around a sole, over its size.
AROUND = 1.3


def contacts(tracks: Tracks) -> list[int]:
    """Indices of the contacts that are active at some time in one of the solutions."""
    return [int(i) for i in np.flatnonzero(np.any([t.solution.active.any(axis=0) for t in tracks], axis=0))]


def stance_row(tracks: Tracks) -> PlotRow | None:
    """Which contacts are active in which phase, for every solution."""
    shown = contacts(tracks)
    height = STANCE_ROW * len(shown) * max(1.0, 0.7 * len(tracks))
    stances = partial(_stances, shown=shown)
    return panel_row("contacts", "contacts", "", stances, height=height, rigid=True) if shown else None


def _stances(axes: Axes, tracks: Tracks, shown: Sequence[int]) -> None:
    tall = BAR / len(tracks)
    for number, track in enumerate(tracks):
        shade = style.GREY if number else style.BLACK
        for row, contact in enumerate(shown):
            at = row - BAR / 2 + (number + 0.5) * tall
            for start, end in stance_spans(track, contact):
                axes.barh(at, end - start, height=0.9 * tall, left=start, color=shade, linewidth=0)
    axes.set_yticks(range(len(shown)), [tracks[0].solution.contact_frames[i] for i in shown])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(shown) - 0.5, -0.5)
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
    ylabel, scale = "f\u209c / (\u03bc f\u2099) [1]", partial(draw.share_axis, edge="edge")
    return draw.curve_row("cone", "share of the friction cone", ylabel, curves, scale)


def contact_curves(tracks: Tracks, values: MotionQuantity) -> list[Curve]:
    """Return a curve for each contact: ``values`` (K, nc) of a motion."""
    frames = tracks[0].solution.contact_frames
    return draw.numbered((frames[i], draw.column(values, i)) for i in contacts(tracks))


def force_pages(tracks: Tracks) -> list[PlotPage]:
    """Return forces of every contact with its cone, tangential over normal forces, impulses, loads."""
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
    shown, frames = contacts(tracks), tracks[0].solution.contact_frames
    panels = [
        PlotPanel(
            name=f"force:{frames[i]}",
            ylabel=f"{frames[i]} f [N]",
            draw=partial(_force, contact=i),
            title="contact forces" if i == shown[0] else "",
        )
        for i in shown
    ]
    rows = batches(panels, CONTACTS_A_ROW)
    return [PlotRow(panels=part, height=1.1, legend=part is rows[0]) for part in rows]


def _force(axes: Axes, tracks: Tracks, contact: int) -> None:
    normal = Curve(label=NORMAL, values=lambda m: m.normal[:, contact], number=0, marked=False)
    tangential = Curve(label=TANGENTIAL, values=lambda m: m.tangential[:, contact], number=1, width=0.9)
    draw.curves(axes, tracks, [normal, tangential])
    draw.fit(axes, zero=True)
    t, cone = tracks[0].curve(lambda motion: motion.cone[:, contact])
    look: dict[str, Any] = {"color": CONE, "linewidth": 0, "zorder": 1, "antialiased": False}
    axes.fill_between(t, 0.0, np.maximum(cone, 0.0), label="cone,\nf\u209c \u2264 \u03bc f\u2099", **look)


def plane_row(tracks: Tracks) -> PlotRow:
    """Return tangential over normal force of each contact: the friction cone seen from the side."""
    title, ylabel = "tangential over normal force", "tangential force f\u209c [N]"
    return panel_row("plane", title, ylabel, _plane, timed=False, height=1.7)


def _plane(axes: Axes, tracks: Tracks) -> None:
    drawn = draw.told_apart(tracks, contact_curves(tracks, lambda motion: motion.normal))
    across = [curve.values for curve in contact_curves(tracks, lambda motion: motion.tangential)]
    for number, track in enumerate(tracks):
        for curve, tangential in zip(drawn, across, strict=True):
            x, y = track.pair(curve.values, tangential)
            axes.plot(x, y, markevery=max(1, len(x) // 8), **curve.look(tracks, number))
    normal = tracks[0].dense.normal
    least, most = np.nanmin(normal, initial=0.0), np.nanmax(normal, initial=1e-9)
    listed = ", ".join(f"{slope:.3g}" for slope in _slopes(tracks[0]))
    slopes, edge = _slopes(tracks[0]), np.array([0.0, 1.05 * most])
    for slope in slopes:
        axes.plot(edge, slope * edge, label=f"edge of the cone,\n\u03bc = {listed}", **draw.LIMIT)
        axes.fill_between(edge, 0.0, slope * edge, color=CONE, alpha=0.5, linewidth=0, zorder=0)
    axes.set(xlim=(least, edge[1]), ylim=(0.0, 1.05 * slopes.max(initial=0.1) * most))
    axes.set_xlabel("normal force f\u2099 [N]")


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
    if not any(track.impact_times for track in tracks):
        return None
    return panel_row("impulses", "impulses of the impacts", "impulse \u039b [N s]", _impulses, timed=False)


def _impulses(axes: Axes, tracks: Tracks) -> None:
    names: list[str] = []
    for track in tracks:
        normal, tangential, cone = impulses_of(track)
        for impact, time in enumerate(track.impact_times):
            for contact in np.flatnonzero(normal[impact]):
                at, place = len(names), (impact, contact)
                axes.plot([at, at], [0.0, normal[place]], color=style.BLUE, linewidth=0.9)
                axes.plot(at, normal[place], "o", color=style.BLUE, markersize=4, label="normal")
                axes.plot(at, tangential[place], "s", color=style.RED, markersize=4, label="tangential")
                axes.plot(at, cone[place], "_", color=style.BLACK, markersize=10, label="\u03bc normal")
                which = f"{style.literal(style.short(track.label))}\n" if len(tracks) > 1 else ""
                names.append(f"{which}{track.solution.contact_frames[contact]}\n{time:.3f} s")
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", labelsize=style.SMALLEST)
    axes.set_xlim(-0.5, max(len(names), 6) - 0.5)
    axes.set_ylim(bottom=0.0)


def _load_row(tracks: Tracks) -> PlotRow | None:
    if not tracks[0].solution.description.payloads:
        return None
    load = Curve(label="magnitude", values=lambda motion: motion.load)
    title, scale = "force of carried bodies on the robot", partial(draw.fit, zero=True)
    return draw.curve_row("load", title, "force |f| [N]", [load], scale, height=1.2, legend=False)


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


def _pressure_share(motion: PlottedMotion, axis: int, half: np.ndarray) -> np.ndarray:
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
