"""Topics about contacts: stance diagram, forces against the friction cone, impulses, soles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.view.plotting import sheet as plot
from trajopt.view.plotting import style
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.sheet import Panel, Sheet
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Inches: height of a contact in the stance diagram, and of the planes of forces and of soles.
STANCE, PLANE, SOLE = 0.14, 2.2, 1.7
# Height of the bars in the stance diagram over that of a contact.
BAR = 0.62
# Panels of contacts side by side.
CONTACTS_A_ROW = 2
NORMAL, TANGENTIAL = "normal f\u2099", "tangential f\u209c"
CONE = "#d9d9d9"
# Range shown around a sole, over its size.
AROUND = 1.3


def contacts(tracks: Sequence[Track]) -> list[int]:
    """Indices of the contacts that are active at some time in one of the solutions."""
    return [int(i) for i in np.flatnonzero(np.any([t.solution.active.any(axis=0) for t in tracks], axis=0))]


def by_contact(tracks: Sequence[Track], values: MotionQuantity) -> dict[str, MotionQuantity]:
    """Return a quantity (K,) for each contact by its frame, from ``values`` (K, nc)."""
    frames = tracks[0].solution.contact_frames
    return {frames[i]: plot.column(values, i) for i in contacts(tracks)}


def draw_forces(sheet: Sheet) -> None:
    """Draw forces of every contact with its cone, tangential over normal forces, impulses, loads."""
    shown, frames = contacts(sheet.tracks), sheet.tracks[0].solution.contact_frames
    if shown:
        draw_stances(sheet)
        titles = ["contact forces"] + [""] * len(shown)
        panels = [
            Panel(name=f"force:{frames[i]}", ylabel=f"{frames[i]} f [N]", title=title)
            for i, title in zip(shown, titles, strict=False)
        ]
        for axes, contact in zip(sheet.grid(panels, CONTACTS_A_ROW, legend=True), shown, strict=True):
            _draw_force(axes, sheet.tracks, contact)
        draw_cone_shares(sheet)
        _draw_plane(sheet)
        _draw_impulses(sheet)
        sheet.notes.append(
            "Shaded: tangential forces within the friction cone. Dotted red: impacts. "
            "Forces of carried bodies are left out."
        )
    if sheet.tracks[0].solution.description.payloads:
        axes = sheet.panel("load", "force of carried bodies on the robot", "force |f| [N]", legend=False)
        plot.curves(axes, sheet.tracks, {"magnitude": lambda motion: motion.load})
        plot.fit(axes, zero=True)


def draw_stances(sheet: Sheet) -> None:
    """Draw which contacts are active in which phase, for every solution."""
    tracks = sheet.tracks
    shown = contacts(tracks)
    if not shown:
        return
    height = STANCE * len(shown) * max(1.0, 0.7 * len(tracks))
    axes, tall = sheet.panel("contacts", "contacts", "", height=height), BAR / len(tracks)
    for track in tracks:
        shade = style.GREY if track.number else style.BLACK
        for row, contact in enumerate(shown):
            at = row - BAR / 2 + (track.number + 0.5) * tall
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


def draw_normal_forces(sheet: Sheet) -> None:
    """Draw normal forces of all contacts."""
    axes = sheet.panel("normal", "normal contact forces", "f\u2099 [N]")
    plot.curves(axes, sheet.tracks, by_contact(sheet.tracks, lambda motion: motion.normal), apart=True)
    plot.fit(axes, zero=True)


def draw_cone_shares(sheet: Sheet) -> None:
    """Draw tangential force over the radius of the friction cone, for all contacts."""
    axes = sheet.panel("cone", "share of the friction cone", "f\u209c / (\u03bc f\u2099) [1]")
    plot.curves(axes, sheet.tracks, by_contact(sheet.tracks, lambda motion: motion.cone_share), apart=True)
    plot.share_axis(axes, edge="edge")


def _draw_force(axes: Axes, tracks: Sequence[Track], contact: int) -> None:
    forces: dict[str, MotionQuantity] = {
        NORMAL: lambda motion: motion.normal[:, contact],
        TANGENTIAL: lambda motion: motion.tangential[:, contact],
    }
    plot.curves(axes, tracks, forces)
    plot.fit(axes, zero=True)
    t, cone = tracks[0].curve(lambda motion: motion.cone[:, contact])
    look: dict[str, Any] = {"color": CONE, "linewidth": 0, "zorder": 1, "antialiased": False}
    axes.fill_between(t, 0.0, np.maximum(cone, 0.0), label="cone,\nf\u209c \u2264 \u03bc f\u2099", **look)


def _draw_plane(sheet: Sheet) -> None:
    """Draw tangential over normal force of each contact: the friction cone seen from the side."""
    tracks, title = sheet.tracks, "tangential over normal force"
    axes = sheet.panel("plane", title, "tangential force f\u209c [N]", timed=False, height=PLANE)
    normal = by_contact(tracks, lambda motion: motion.normal)
    tangential = by_contact(tracks, lambda motion: motion.tangential)
    for track in tracks:
        for number, frame in enumerate(normal):
            x, y = track.pair(normal[frame], tangential[frame])
            line = plot.line_look(tracks, track, number, len(normal), apart=True)
            axes.plot(x, y, label=style.literal(frame).lstrip("_"), markevery=max(1, len(x) // 8), **line)
    motion = tracks[0].dense
    least, most = np.nanmin(motion.normal, initial=0.0), np.nanmax(motion.normal, initial=1e-9)
    slopes = np.unique(np.round(motion.surfaces.friction[motion.solution.active], 9))
    edge, listed = np.array([0.0, 1.05 * most]), ", ".join(f"{slope:.3g}" for slope in slopes)
    for slope in slopes:
        axes.plot(edge, slope * edge, label=f"edge of the cone,\n\u03bc = {listed}", **plot.LIMIT)
        axes.fill_between(edge, 0.0, slope * edge, color=CONE, alpha=0.5, linewidth=0, zorder=0)
    axes.set(xlim=(least, edge[1]), ylim=(0.0, 1.05 * slopes.max(initial=0.1) * most))
    axes.set_xlabel("normal force f\u2099 [N]")


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


def _draw_impulses(sheet: Sheet) -> None:
    tracks = sheet.tracks
    names: list[str] = []
    if not any(track.impact_times for track in tracks):
        return
    axes = sheet.panel("impulses", "impulses of the impacts", "impulse \u039b [N s]", timed=False)
    for track in tracks:
        normal, tangential, cone = impulses_of(track)
        which = f"{style.literal(style.short(track.label))}\n" if len(tracks) > 1 else ""
        for impact, time in enumerate(track.impact_times):
            for contact in np.flatnonzero(normal[impact]):
                at, place = len(names), (impact, contact)
                axes.plot([at, at], [0.0, normal[place]], color=style.BLUE, linewidth=0.9)
                axes.plot(at, normal[place], "o", color=style.BLUE, markersize=4, label="normal")
                axes.plot(at, tangential[place], "s", color=style.RED, markersize=4, label="tangential")
                axes.plot(at, cone[place], "_", color=style.BLACK, markersize=10, label="\u03bc normal")
                names.append(f"{which}{track.solution.contact_frames[contact]}\n{time:.3f} s")
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", labelsize=style.SMALLEST)
    axes.set_xlim(-0.5, max(len(names), 6) - 0.5)
    axes.set_ylim(bottom=0.0)


def draw_soles(sheet: Sheet) -> None:
    """Draw centres of pressure in the soles, seen from above and over time."""
    tracks, described = sheet.tracks, sheet.tracks[0].solution.description.contacts
    sizes = {i: described[i].half_size for i in contacts(tracks) if described[i].is_sole}
    soles = {i: size for i, size in sizes.items() if size is not None}
    if not any(np.isfinite(track.dense.pressure_centre[:, list(soles)]).any() for track in tracks):
        return
    frames = [described[i].frame for i in soles]
    panels = [Panel(name=f"sole:{frame}", ylabel="y [m]", title=frame) for frame in frames]
    placed = sheet.grid(panels, CONTACTS_A_ROW, timed=False, height=SOLE)
    for axes, contact in zip(placed, soles, strict=True):
        _draw_sole(axes, tracks, contact, soles[contact])
    for axis, word in enumerate(("along (x)", "across (y)")):
        half = np.array([soles[i][axis] if i in soles else np.nan for i in range(len(described))])
        title = f"centre of pressure {word}, over the sole's half size"
        axes = sheet.panel(f"pressure:{axis}", title, "offset / half size [1]")
        plot.curves(axes, tracks, by_contact(tracks, partial(_pressure_share, axis=axis, half=half)))
        low, high = plot.fit(axes)
        plot.set_range(axes, min(-1.0, low), max(1.0, high))
        for edge in (-1.0, 1.0):
            axes.axhline(edge, **plot.LIMIT)
    sheet.notes.append(
        "Centre of pressure in the sole's own axes; the frame is its edge. Dots darken with time."
    )


def _pressure_share(motion: PlottedMotion, axis: int, half: np.ndarray) -> np.ndarray:
    return np.asarray(motion.pressure_centre[..., axis] / half)


def _draw_sole(axes: Axes, tracks: Sequence[Track], contact: int, half: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    length, width = half
    axes.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, linewidth=1.0))
    motion = tracks[0].dense
    x, y = motion.pressure_centre[:, contact].T
    shown = np.isfinite(x)
    axes.scatter(x[shown], y[shown], c=motion.t[shown], s=5, cmap=style.TIMES, linewidths=0, zorder=3)
    along, across = (plot.column(lambda motion: motion.pressure_centre[:, contact], i) for i in (0, 1))
    for track in tracks:
        look = {"color": style.GREY, "linewidth": 0.6, "linestyle": track.line_style}
        axes.plot(*track.pair(along, across), label="pressure", **look)
    axes.set(xlim=(-AROUND * length, AROUND * length), ylim=(-AROUND * width, AROUND * width))
    axes.set_aspect("equal", anchor="NW")
    axes.set_xlabel("x [m]")
