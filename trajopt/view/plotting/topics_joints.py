"""Topics about joints: positions, velocities, torques, shares of their limits, and their drives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.robot.actuators.drive import Drive
from trajopt.view.plotting import sheet as plot
from trajopt.view.plotting import style
from trajopt.view.plotting.joints import (
    BEYOND,
    FAR,
    KINDS,
    JointAxis,
    Limb,
    are_far,
    limbs_of,
    limit_of,
    limit_words,
    most_used,
    share,
    units_of,
    value,
)
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.sheet import Panel, Sheet
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Robots with this few limbs have a whole row for each kind of quantity.
WIDE_LIMBS = 2
# Most limbs side by side in one row.
LIMBS_A_ROW = 4
# A limit is shown if values reach this fraction of it, else it would only flatten the curves.
NEAR = 0.75
SYMBOLS = {"position": "q", "velocity": "v", "torque": "\u03c4"}
# Inches: height of a row in a map of shares, least height of a map, and height of a torque-speed plane.
MAP_ROW, LEAST_MAP, PLANE = 0.135, 0.75, 1.9
# Share from which its number is bold, and tolerance above 1 that still counts as on the limit.
CLOSE, ON_LIMIT = 0.98, 1e-4
# Columns of a map of shares.
COLUMNS = 400
# The colour bar: left edge, lower edge, width and height over those of the map on its left.
BAR = (1.22, 0.0, 0.04, 1.0)
# Number of joints whose shares are drawn as curves: those that come nearest to their limits.
MOST_USED = 5
PLANES_A_ROW = 3
# Points along an envelope, and how far it is drawn beyond the no-load speed or the motion.
ENVELOPE, MARGIN = 200, 1.1


def limbs(tracks: Sequence[Track]) -> tuple[Limb, ...]:
    """The limbs of the solutions' robot."""
    return limbs_of(tracks[0].axes, tracks[0].solution.model)


def draw_joints(sheet: Sheet) -> None:
    """Draw position, velocity and torque of every limb's joints, against their limits."""
    shown = limbs(sheet.tracks)
    for limb in shown:
        draw_limb(sheet, limb, wide=len(shown) <= WIDE_LIMBS, alone=len(shown) == 1)
    if shown:
        sheet.notes.append(
            "Curves are the solution's own interpolation, dots its collocation points. Dashed: limits that "
            "values come near, in the joint's colour; black, hatched beyond, where a panel's joints share "
            "them. Others are beyond the axis, which is scaled by what is used."
        )


def draw_limb(sheet: Sheet, limb: Limb, *, wide: bool, alone: bool = False) -> None:
    """Draw position, velocity and torque of a limb's joints side by side, or ``wide`` below one another.

    A limb that is ``alone`` needs no name besides the prefix of its joints.
    """
    kinds = [kind for kind in KINDS if kind != "torque" or any(axis.torque is not None for axis in limb.axes)]
    name = limb.prefix if alone else limb.name
    panels = []
    for kind in kinds:
        noun = f"{name}: {_noun(kind, limb)}" if name else _noun(kind, limb)
        panels.append(
            Panel(
                name=f"{kind}:{limb.name}",
                ylabel=f"{_noun(kind, limb)} {SYMBOLS[kind]} [{units_of(kind, limb.axes)}]",
                title=noun if wide else limb.name if kind == KINDS[0] else "",
                remark=limits_beyond(sheet.tracks, kind, limb.axes),
            )
        )
    placed = [sheet.row(panel)[0] for panel in panels] if wide else sheet.row(*panels)
    for axes, kind in zip(placed, kinds, strict=True):
        _draw_limb(axes, sheet.tracks, limb, kind)


def draw_torques(sheet: Sheet) -> None:
    """Draw torques side by side: of the limb with the largest torque, and of limbs like it.

    Limbs are alike if their joints have the same names; the row has one legend.
    """
    tracks = sheet.tracks
    driven = [limb for limb in limbs(tracks) if any(axis.torque is not None for axis in limb.axes)]
    if not driven:
        return
    most = max(driven, key=lambda limb: max(most_used("torque", limb.axes, track.dense) for track in tracks))
    alike = [limb for limb in driven if limb.short == most.short]
    shown = alike[:LIMBS_A_ROW] if most in alike[:LIMBS_A_ROW] else [most]
    remarks = [limits_beyond(tracks, "torque", limb.axes) for limb in shown]
    same = len(set(remarks)) == 1 and len(shown) > 2  # narrow panels: common words go into the heading
    title = f"{_noun('torque', most)}s by limb{f' ({remarks[0]})' if same and remarks[0] else ''}"
    panels = [
        Panel(
            name=f"torque:{limb.name}",
            ylabel="" if number else f"{SYMBOLS['torque']} [{units_of('torque', limb.axes)}]",
            title="" if number else title,
            remark=f"{limb.name}: {remark}" if remark and not same else limb.name,
        )
        for number, (limb, remark) in enumerate(zip(shown, remarks, strict=True))
    ]
    for axes, limb in zip(sheet.row(*panels), shown, strict=True):
        _draw_limb(axes, tracks, limb, "torque")


def limits_beyond(tracks: Sequence[Track], kind: str, axes: Sequence[JointAxis]) -> str:
    """Text on limits of velocity or torque that are all beyond the axis of the plot; empty otherwise."""
    if kind == "position":
        return ""
    least = min(limit_of(kind, axis)[1] for axis in axes)
    used = max(most_used(kind, axes, track.dense) for track in tracks)
    words = limit_words(kind, axes) if NEAR * least > used else ""
    return f"{words}, {BEYOND}" if words else ""


def _noun(kind: str, limb: Limb) -> str:
    return "force" if kind == "torque" and limb.unit == "m" else kind


def _draw_limb(axes: Axes, tracks: Sequence[Track], limb: Limb, kind: str) -> None:
    """Draw the joints' curves and the limits that they come near, hatched if all joints share them."""
    named = {name: partial(value, kind, axis) for name, axis in zip(limb.short, limb.axes, strict=True)}
    plot.curves(axes, tracks, named)
    low, high = plot.fit(axes)
    shown = [axis for axis in limb.axes if kind != "torque" or axis.torque is not None]
    limits = {limit_of(kind, axis) for axis in shown}
    near = {axis: _limits_near(kind, axis, tracks) for axis in shown}
    every = {line for lines in near.values() for line in lines}
    plot.set_range(axes, min(low, *every, high), max(high, *every, low))
    if len(shown) < 2 or len(limits) > 1:
        for axis, lines in near.items():
            look = {**plot.LIMIT, "color": style.COLOURS[limb.axes.index(axis)]}
            for line in lines:
                axes.axhline(line, **look, zorder=2)
        return
    (shared,), (bottom, top) = limits, axes.get_ylim()
    for line in every:
        axes.axhline(line, **plot.LIMIT, zorder=2)
        axes.axhspan(*sorted((line, bottom if line == shared[0] else top)), **plot.HATCHED)


def _limits_near(kind: str, axis: JointAxis, tracks: Sequence[Track]) -> list[float]:
    """The limits that values come near: at `NEAR` of the way from the middle of the range, or from zero."""
    lower, upper = limit_of(kind, axis)
    values = np.concatenate([value(kind, axis, track.dense) for track in tracks])
    finite = values[np.isfinite(values)]
    if not finite.size:
        return []
    middle = (lower + upper) / 2 if np.isfinite(lower) and np.isfinite(upper) else 0.0
    reached = {lower: middle - finite.min(), upper: finite.max() - middle}
    return [
        limit for limit, way in reached.items() if np.isfinite(limit) and way >= NEAR * abs(limit - middle)
    ]


def draw_limits(sheet: Sheet) -> None:
    """Draw maps of the shares of all limits over time for each solution, and the most used as curves."""
    tracks = sheet.tracks
    every = {name: axis for limb in limbs(tracks) for name, axis in zip(limb.long, limb.axes, strict=True)}
    if not every:
        return
    for track in tracks:
        draw_share_maps(sheet, track, {name: [axis] for name, axis in every.items()})
    for kind in KINDS:
        shares = {name: partial(share, kind, axis) for name, axis in every.items()}
        peaks = {name: _peak(tracks, values) for name, values in shares.items()}
        most = sorted((name for name in peaks if np.isfinite(peaks[name])), key=lambda name: -peaks[name])
        if most:
            axes = sheet.panel(f"used:{kind}", f"{kind}: most used", "share [1]")
            plot.curves(axes, tracks, {name: shares[name] for name in most[:MOST_USED]}, apart=True)
            plot.share_axis(axes)
    sheet.notes.append(
        "Share of the limit that each joint uses, and on the right its largest in per cent, bold from 98 %. "
        "Of a position: its distance from the middle of its range over half of it. White: no limit. "
        "Where limits are far beyond what is used, the largest value used is 100 %. Orange: beyond a limit. "
        "Each column of the picture shows the largest value within its time."
    )


def _peak(tracks: Sequence[Track], values: MotionQuantity) -> float:
    """The largest finite value of all solutions; NaN if there is none."""
    return float(np.fmax.reduce(np.concatenate([values(track.dense) for track in tracks])))


def draw_share_maps(sheet: Sheet, track: Track, groups: dict[str, list[JointAxis]]) -> None:
    """Draw maps of a solution's positions, velocities and torques: the largest share of each group of axes.

    If all limits are far beyond the values, shares are of the largest value instead. The colour bar is on the
    right.
    """
    every, motion = [axis for group in groups.values() for axis in group], track.dense
    several = f", {track.label}" if len(sheet.tracks) > 1 else ""
    panels, shares, limited = [], [], []
    for kind in KINDS:
        far, scale = are_far(kind, every, motion), most_used(kind, every, motion)
        panels.append(
            Panel(
                name=f"share:{kind}:{track.number}",
                title=kind + several + (f", 100 % is {scale:.3g} {units_of(kind, every)}" if far else ""),
                remark=f"{limit_words(kind, every)}, {BEYOND}" if far else "",
            )
        )
        limited.append(not far)
        parts = [
            np.fmax.reduce([np.abs(value(kind, axis, motion)) for axis in group]) / scale
            if far
            else largest_share(kind, group, motion)
            for group in groups.values()
        ]
        shares.append(np.array(parts).T)
    placed = sheet.row(*panels, height=max(LEAST_MAP, MAP_ROW * len(groups)))
    for number, axes in enumerate(placed):
        image = _draw_map(axes, track, list(groups), shares[number], limited=limited[number])
        axes.tick_params(axis="y", labelleft=number == 0)
    bar = axes.figure.colorbar(image, cax=axes.inset_axes(BAR, label="scale"), extend="max")
    bar.set_ticks([0.0, 0.5, 1.0], labels=["0", "50", "100 %"])


def largest_share(kind: str, group: Sequence[JointAxis], motion: PlottedMotion) -> np.ndarray:
    """The largest share (K,) of a group of axes; NaN if none has a limit."""
    return np.asarray(np.fmax.reduce([share(kind, axis, motion) for axis in group]))


def draw_largest_shares(sheet: Sheet) -> None:
    """Draw the largest share over all joints of positions, velocities and torques, where there are limits."""
    shares = {kind: partial(largest_share, kind, sheet.tracks[0].axes) for kind in KINDS}
    if any(np.isfinite(_peak(sheet.tracks, values)) for values in shares.values()):
        axes = sheet.panel("largest share", "largest share of the limits", "share [1]")
        plot.curves(axes, sheet.tracks, shares, dots=False)
        plot.share_axis(axes)


def _draw_map(axes: Axes, track: Track, names: Sequence[str], shares: np.ndarray, *, limited: bool) -> Any:
    """Draw shares (K, n) of limits over time as colours: a row for each name, with its largest in per cent.

    A column of the picture shows the largest share within its time, so that no peak is lost. Values beyond
    the limit have a separate colour; NaN, where there is no limit, is left white. With ``limited``, shares
    are of limits, and those close to 1 are bold. Returns the image.
    """
    import matplotlib as mpl

    start, end, bottom = track.phases[0].start, track.phases[-1].end, len(names) - 0.5
    image = axes.imshow(
        column_maxima(track.dense.t, shares, start, end).T,
        extent=(start, end, bottom, -0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=mpl.colormaps[style.SHARES].with_extremes(over=style.BEYOND, bad="white"),
        vmin=0.0,
        vmax=1.0 + ON_LIMIT,
    )
    axes.grid(False)
    for phase in track.phases[1:]:
        axes.axvline(phase.start, color=style.GREY, linewidth=0.4)
    axes.set_ylim(bottom, -0.5)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0, labelsize=style.TINY)
    for row, peak in enumerate(np.fmax.reduce(np.where(np.isfinite(shares), shares, np.nan))):
        if np.isfinite(peak):
            weight = "bold" if limited and peak >= CLOSE else "normal"
            look: dict[str, Any] = {"fontsize": style.SMALLEST, "va": "center", "weight": weight}
            axes.text(1.015, row, f"{100 * peak:.0f}", transform=axes.get_yaxis_transform(), **look)
    return image


def column_maxima(t: np.ndarray, shares: np.ndarray, start: float, end: float) -> np.ndarray:
    """The largest of ``shares`` (K, n) in each of `COLUMNS` equal spans; the next sample if it has none."""
    edges = np.linspace(start, end, COLUMNS + 1)
    centres = (edges[1:] + edges[:-1]) / 2
    maxima = shares[np.clip(np.searchsorted(t, centres), 0, len(t) - 1)]
    column = np.clip(((t - start) / (end - start) * COLUMNS).astype(int), 0, COLUMNS - 1)
    np.fmax.at(maxima, column, shares)
    return maxima


def torque_share(axis: JointAxis, drive: Drive, motion: PlottedMotion) -> np.ndarray:
    """Motor torque over its limit (K,), equal to current over its limit; NaN without a limit."""
    if not np.isfinite(drive.torque_limit):
        return np.full(len(motion.t), np.nan)
    return np.abs(drive.motor_torque(motion.drive_torque[:, axis.torque])) / drive.torque_limit


def voltage_share(axis: JointAxis, drive: Drive, motion: PlottedMotion) -> np.ndarray:
    """Voltage over the largest voltage (K,); NaN without a voltage line."""
    if not np.isfinite(drive.stall_torque):
        return np.full(len(motion.t), np.nan)
    return np.abs(drive.voltage_use(motion.drive_torque[:, axis.torque], motion.rates[:, axis.torque]))


def draw_drives(sheet: Sheet) -> None:
    """Draw shares of current and voltage over time, then every drive in its torque-speed plane."""
    tracks, drives = sheet.tracks, sheet.tracks[0].dense.drives
    of = {axis: drives[axis.torque] for axis in tracks[0].axes if drives and axis.torque is not None}
    driven = [(axis, drive) for axis, drive in of.items() if drive is not None]
    if not driven:
        return
    for share_of, title in (
        (torque_share, "motor torque (current) over its limit"),
        (voltage_share, "motor voltage over its limit"),
    ):
        for start in range(0, len(driven), len(style.COLOURS)):
            part = driven[start : start + len(style.COLOURS)]
            shares = {axis.name: partial(share_of, axis, drive) for axis, drive in part}
            if any(np.isfinite(_peak(tracks[:1], values)) for values in shares.values()):
                axes = sheet.panel(f"{share_of.__name__}:{start}", title, "share [1]")
                plot.curves(axes, tracks, shares)
                plot.share_axis(axes)
    panels = [
        Panel(
            name=f"plane:{axis.name}",
            ylabel=f"{axis.name}  {'f [N]' if axis.slides else 'τ [N m]'}",
            title="" if number else "torque over speed, joint side",
        )
        for number, (axis, _) in enumerate(driven)
    ]
    placed = sheet.grid(panels, PLANES_A_ROW, timed=False, height=PLANE)
    for axes, (axis, drive) in zip(placed, driven, strict=True):
        _draw_plane(axes, tracks, axis, drive)
    sheet.notes.append(
        "Torque that the drive delivers, with joint friction. Shaded: what voltage and current allow. Dots: "
        "collocation points. Dashed red: the joint's velocity limit."
    )


def _draw_plane(axes: Axes, tracks: Sequence[Track], axis: JointAxis, drive: Drive) -> None:
    row = axis.torque
    fastest = max(float(np.nanmax(np.abs(track.dense.rates[:, row]), initial=0.0)) for track in tracks)
    ends = [speed for speed in (drive.joint_no_load_speed, axis.speed) if np.isfinite(speed)]
    end = min(ends, default=fastest)
    unlimited = not np.isfinite(drive.joint_no_load_speed)  # else its envelope is what the panel is for
    far = unlimited and end > FAR * fastest > 0
    end = MARGIN * max(fastest if far else end, fastest, 1e-9)
    rate = np.linspace(-end, end, ENVELOPE)
    low, high = (np.broadcast_to(bound, rate.shape) for bound in drive.torque_range(rate))
    if np.isfinite(low).all() and np.isfinite(high).all():
        inside = low <= high
        axes.fill_between(rate, low, high, where=inside, color=style.BAND, linewidth=0, zorder=0)
        for bound in (low, high):
            axes.plot(rate, np.where(inside, bound, np.nan), color=style.BLACK, linewidth=0.8)
    look: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.9, "label": axis.name}
    for track in tracks:
        rates, torques = track.dense.rates[:, row], track.dense.drive_torque[:, row]
        axes.plot(rates, torques, linestyle=track.line_style, **look)
    points, at = tracks[0].points, tracks[0].points.solution.collocation
    axes.plot(points.rates[at, row], points.drive_torque[at, row], color=style.BLUE, **style.DOTTED)
    if far:
        axes.set_xlim(-end, end)
        axes.set_ylim(top=axes.get_ylim()[0] + 1.1 * np.ptp(axes.get_ylim()))  # room for the remark
        plot.remark_inside(axes, f"{limit_words('velocity', [axis])}, {BEYOND}")
    elif np.isfinite(axis.speed):
        for speed in (-axis.speed, axis.speed):
            axes.axvline(speed, **{**plot.LIMIT, "color": style.RED})
    axes.set_xlabel(f"rate [{axis.unit}/s]")
