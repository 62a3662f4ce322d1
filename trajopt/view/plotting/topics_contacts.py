"""Pages about contacts: who stands when, forces against the friction cone, impulses, soles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve
from trajopt.view.plotting.motion import Motion
from trajopt.view.plotting.page import LEFT, Entry, Page, Panel, Row, Tracks
from trajopt.view.plotting.time_axis import impact_times
from trajopt.view.plotting.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A row of the diagram of stances in units of a row's height; height of its bars.
STANCE_ROW, BAR = 0.11, 0.62
# Inches of a letter in the names of contacts.
NAME_LETTER = 0.06
# Panels of contacts side by side, and rows of them on a page.
CONTACTS_A_ROW, ROWS_A_PAGE = 2, 3
NORMAL, TANGENTIAL = style.BLUE, style.RED
CONE = "#d9d9d9"


def contacts(tracks: Tracks) -> list[int]:
    """Contacts that are active at some time in one of the solutions."""
    return [int(i) for i in np.flatnonzero(np.any([t.solution.active.any(axis=0) for t in tracks], axis=0))]


def stance_row(tracks: Tracks) -> Row | None:
    """Which contacts are active in which phase, for every solution."""
    found, frames = contacts(tracks), tracks[0].solution.contact_frames
    if not found:
        return None
    left = max(LEFT, 0.25 + NAME_LETTER * max(len(frames[i]) for i in found))
    return Row(
        title="contacts",
        panels=(Panel(name="contacts", ylabel="", draw=partial(_stances, found=found)),),
        height=STANCE_ROW * len(found) * max(1.0, 0.7 * len(tracks)),
        left=left,
        rigid=True,
    )


def _stances(axes: Axes, tracks: Tracks, found: Sequence[int]) -> None:
    names = [tracks[0].solution.contact_frames[i] for i in found]
    tall = BAR / len(tracks)
    for number, track in enumerate(tracks):
        shade = style.BLACK if number == 0 else style.GREY
        for row, contact in enumerate(found):
            at = row - BAR / 2 + (number + 0.5) * tall
            for start, end in stances(track, contact):
                axes.barh(at, end - start, height=0.9 * tall, left=start, color=shade, linewidth=0)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)


def stances(track: Track, contact: int) -> list[tuple[float, float]]:
    """Start and end, s, of every stretch of intervals in which a contact is active."""
    plan = track.solution
    active = np.array([plan.active[rows.start, contact] for rows in plan.intervals])
    changes = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(int)))
    return [
        (float(plan.interval_t[first, 0]), float(plan.interval_t[stop - 1, 1]))
        for first, stop in zip(changes[::2], changes[1::2], strict=True)
    ]


def normal_row(tracks: Tracks) -> Row:
    """Normal forces of all contacts."""
    drawn = each(tracks, lambda motion, i: motion.normal[:, i])
    return Row(
        title="normal contact forces",
        panels=(Panel(name="normal", ylabel="f\u2099 [N]", draw=partial(_zero, drawn=drawn)),),
        legend=tuple(curve.entry for curve in drawn),
    )


def cone_row(tracks: Tracks) -> Row:
    """Tangential force over the radius of the friction cone, for all contacts."""
    drawn = each(tracks, lambda motion, i: motion.cone_share[:, i])
    return Row(
        title="share of the friction cone",
        panels=(
            Panel(
                name="cone", ylabel="f\u209c / (\u03bc f\u2099) [1]", draw=partial(_cone_share, drawn=drawn)
            ),
        ),
        legend=tuple(curve.entry for curve in drawn),
    )


def each(tracks: Tracks, values: Callable[[Motion, int], np.ndarray]) -> list[Curve]:
    """A curve for each contact: ``values`` (K,) of a motion and the number of a contact."""
    frames = tracks[0].solution.contact_frames
    return [
        Curve(label=frames[contact], values=partial(_column, values=values, i=contact), number=number)
        for number, contact in enumerate(contacts(tracks))
    ]


def _column(motion: Motion, values: Callable[[Motion, int], np.ndarray], i: int) -> np.ndarray:
    return np.asarray(values(motion, i))


def _zero(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn)
    draw.fit(axes, zero=True)


def _cone_share(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn)
    draw.share_axis(axes)


def force_pages(tracks: Tracks) -> list[Page]:
    """Forces of every contact with its cone, all in the plane of the cone, impulses, loads."""
    found = contacts(tracks)
    if not found:
        return _load_page(tracks)
    rows: list[Row] = []
    legend = (
        Entry(label="normal f\u2099", style={"color": NORMAL}),
        Entry(
            label="tangential f\u209c",
            style={"color": TANGENTIAL, "linewidth": 0.9, "marker": "s", **draw.marker_look(TANGENTIAL)},
        ),
        Entry(label="cone, f\u209c \u2264 \u03bc f\u2099", style={"color": CONE, "linewidth": 5}),
    )
    for start in range(0, len(found), CONTACTS_A_ROW):
        part = found[start : start + CONTACTS_A_ROW]
        frames = tracks[0].solution.contact_frames
        panels = tuple(
            Panel(name=f"force:{frames[i]}", ylabel=f"{frames[i]} f [N]", draw=partial(_force, contact=i))
            for i in part
        )
        title = "contact forces" if start == 0 else ""
        rows.append(Row(title=title, panels=panels, legend=legend if start == 0 else (), height=1.1))
    rows.append(cone_row(tracks))
    plane = [plane_row(tracks)]
    impulses = _impulse_row(tracks)
    last = plane + ([impulses] if impulses else []) + _load_rows(tracks)
    stances = stance_row(tracks)
    head = [stances] if stances else []
    note = (
        "Shaded: tangential forces within the friction cone. Dotted red: impacts. "
        "Forces of carried bodies are left out."
    )
    if len(rows) <= ROWS_A_PAGE + 1:
        return [Page(name="forces", title="contact forces", rows=(*head, *rows, *last), note=note)]
    return [
        Page(name="forces", title="contact forces", rows=(*head, *rows[:-1][:6]), note=note),
        *(
            [Page(name="forces", title="contact forces", rows=tuple(rows[6:-1]), note=note)]
            if len(rows) > 7
            else []
        ),
        Page(name="forces", title="contact forces", rows=(rows[-1], *last), note=note),
    ]


def _force(axes: Axes, tracks: Tracks, contact: int) -> None:
    for track in tracks[:1]:
        t, cone = track.curve(lambda motion: motion.cone[:, contact])
        axes.fill_between(t, 0.0, np.maximum(cone, 0.0), color=CONE, linewidth=0, zorder=1, antialiased=False)
    normal = Curve(label="normal", values=lambda m: m.normal[:, contact], number=0, marked=False)
    tangential = Curve(label="tangential", values=lambda m: m.tangential[:, contact], number=1, width=0.9)
    draw.curves(axes, tracks, [normal, tangential])
    draw.fit(axes, zero=True)


def plane_row(tracks: Tracks) -> Row:
    """Tangential over normal force: the friction cone seen from the side, by contact."""
    drawn = each(tracks, lambda motion, i: motion.normal[:, i])
    return Row(
        title="tangential over normal force",
        panels=(
            Panel(
                name="plane",
                ylabel="tangential force f\u209c [N]",
                draw=partial(_plane, drawn=drawn),
                timed=False,
            ),
        ),
        legend=tuple(curve.entry for curve in drawn),
        height=1.7,
    )


def _plane(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    for number, track in enumerate(tracks):
        for curve, contact in zip(drawn, contacts(tracks), strict=True):
            normal, tangential = track.pair(curve.values, partial(_tangential, contact=contact))
            axes.plot(
                normal,
                tangential,
                color=curve.colour,
                linestyle=style.LINES[number % len(style.LINES)],
                linewidth=0.9,
                marker=curve.marker,
                markevery=max(1, len(normal) // 8),
                label=f"{curve.label}/{track.label}",
                **draw.marker_look(curve.colour),
            )
    draw.fit(axes, zero=True)
    motion = tracks[0].dense
    most = np.nanmax(np.where(np.isfinite(motion.normal), motion.normal, 0.0), initial=1e-9)
    axes.set_xlim(
        min(0.0, float(np.nanmin(np.where(np.isfinite(motion.normal), motion.normal, 0.0), initial=0.0))),
        1.05 * most,
    )
    for friction in np.unique(np.round(motion.surfaces.friction[motion.solution.active], 9)):
        edge = np.array([0.0, 1.05 * most])
        axes.plot(edge, friction * edge, color=style.BLACK, linewidth=0.8, linestyle=draw.LIMIT_DASHES)
        axes.fill_between(edge, 0.0, friction * edge, color=CONE, alpha=0.5, linewidth=0, zorder=0)
    axes.set_ylim(0.0, 1.05 * float(motion.surfaces.friction[motion.solution.active].max(initial=0.1)) * most)
    axes.set_xlabel("normal force f\u2099 [N]; dashed: edge of the cone", labelpad=1.0)


def _tangential(motion: Motion, contact: int) -> np.ndarray:
    return np.asarray(motion.tangential[:, contact])


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


def _impulse_row(tracks: Tracks) -> Row | None:
    if not any(impact_times(track) for track in tracks):
        return None
    legend = (
        Entry(label="normal", style={"color": NORMAL, "marker": "o", "linestyle": "none"}),
        Entry(label="tangential", style={"color": TANGENTIAL, "marker": "s", "linestyle": "none"}),
        Entry(label="\u03bc normal", style={"color": style.BLACK, "marker": "_", "linestyle": "none"}),
    )
    panel = Panel(name="impulses", ylabel="impulse \u039b [N s]", draw=_impulses, timed=False)
    return Row(title="impulses of the impacts", panels=(panel,), legend=legend)


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


def _load_rows(tracks: Tracks) -> list[Row]:
    if not tracks[0].meta.get("payloads"):
        return []
    drawn = [Curve(label="magnitude", values=lambda motion: motion.load, number=0)]
    panel = Panel(name="load", ylabel="force |f| [N]", draw=partial(_zero, drawn=drawn))
    return [Row(title="force of carried bodies on the robot", panels=(panel,), height=1.2)]


def _load_page(tracks: Tracks) -> list[Page]:
    rows = _load_rows(tracks)
    return [Page(name="forces", title="contact forces", rows=tuple(rows))] if rows else []
