"""Pages about joints and their drives: positions, velocities, torques, operating points, and their limits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.robot.actuators.drive import Drive
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve, PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of
from trajopt.view.plotting.joints import (
    BEYOND,
    FAR,
    KINDS,
    JointAxis,
    Limb,
    limbs_of,
    limit_of,
    limit_words,
    most_used,
    units_of,
    value,
)
from trajopt.view.plotting.motion import PlottedMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Rows of limbs on one page; robots with this few limbs have a whole row for each kind of quantity.
LIMBS_A_PAGE, WIDE_LIMBS = 6, 2
# Most limbs side by side in one row.
LIMBS_A_ROW = 4
# Smallest span of a vertical axis in SI units: smaller differences are rounding.
LEAST_SPAN = 1e-6
# A limit is shown if values reach this fraction of it, else it would only flatten the curves.
NEAR = 0.75
SYMBOLS = {"position": "q", "velocity": "v", "torque": "\u03c4"}
PLANES_A_ROW, ROWS_A_PAGE = 3, 4
# Points along an envelope, and how far it is drawn beyond the no-load speed or the motion.
ENVELOPE, MARGIN = 200, 1.1


def limbs(tracks: Tracks) -> tuple[Limb, ...]:
    """The limbs of the solutions' robot."""
    return limbs_of(tracks[0].axes, tracks[0].solution.model)


def joint_pages(tracks: Tracks) -> list[PlotPage]:
    """Position, velocity and torque of every limb's joints, against their limits."""
    shown = limbs(tracks)
    wide, alone = len(shown) <= WIDE_LIMBS, len(shown) == 1
    rows = [row for limb in shown for row in limb_rows(tracks, limb, wide=wide, alone=alone)]
    note = (
        "Curves are the solution's own interpolation, dots its collocation points. Dashed: limits that "
        "values come near, in the joint's colour; black, hatched beyond, where a panel's joints share them. "
        "Others are beyond the axis, which is scaled by what is used."
    )
    return page_of("joints", "joints", *batches(rows, LIMBS_A_PAGE), note=note)


def limb_rows(tracks: Tracks, limb: Limb, *, wide: bool, alone: bool = False) -> list[PlotRow]:
    """Position, velocity and torque of a limb's joints side by side, or ``wide`` below one another.

    A limb that is ``alone`` needs no name besides the prefix of its joints.
    """
    kinds = [kind for kind in KINDS if kind != "torque" or any(axis.torque is not None for axis in limb.axes)]
    name = limb.prefix if alone else limb.name
    panels = []
    for kind in kinds:
        noun = f"{name}: {_noun(kind, limb)}" if name else _noun(kind, limb)
        panels.append(
            PlotPanel(
                name=f"{kind}:{limb.name}",
                ylabel=f"{_noun(kind, limb)} {SYMBOLS[kind]} [{units_of(kind, limb.axes)}]",
                draw=partial(_limb, limb=limb, kind=kind),
                title=noun if wide else limb.name if kind == KINDS[0] else "",
                remark=limits_beyond(tracks, kind, limb.axes),
            )
        )
    return [PlotRow(panels=[panel]) for panel in panels] if wide else [PlotRow(panels=panels)]


def torque_row(tracks: Tracks) -> PlotRow | None:
    """Return torques side by side: of the limb with the largest torque, and of limbs like it.

    Limbs are alike if their joints have the same names; the row has one legend. None without torques.
    """
    driven = [limb for limb in limbs(tracks) if any(axis.torque is not None for axis in limb.axes)]
    if not driven:
        return None
    most = max(driven, key=lambda limb: max(most_used("torque", limb.axes, track.dense) for track in tracks))
    alike = [limb for limb in driven if limb.short == most.short]
    shown = alike[:LIMBS_A_ROW] if most in alike[:LIMBS_A_ROW] else [most]
    remarks = [limits_beyond(tracks, "torque", limb.axes) for limb in shown]
    same = len(set(remarks)) == 1 and len(shown) > 2  # narrow panels: common words go into the heading
    title = f"{_noun('torque', most)}s by limb{f' ({remarks[0]})' if same and remarks[0] else ''}"
    panels = [
        PlotPanel(
            name=f"torque:{limb.name}",
            ylabel="" if number else f"{SYMBOLS['torque']} [{units_of('torque', limb.axes)}]",
            draw=partial(_limb, limb=limb, kind="torque"),
            title="" if number else title,
            remark=f"{limb.name}: {remark}" if remark and not same else limb.name,
        )
        for number, (limb, remark) in enumerate(zip(shown, remarks, strict=True))
    ]
    return PlotRow(panels=panels)


def limits_beyond(tracks: Tracks, kind: str, axes: Sequence[JointAxis]) -> str:
    """Text on limits of velocity or torque that are all beyond the axis of the plot; empty otherwise."""
    if kind == "position":
        return ""
    least = min(limit_of(kind, axis)[1] for axis in axes)
    used = max(most_used(kind, axes, track.dense) for track in tracks)
    words = limit_words(kind, axes) if NEAR * least > used else ""
    return f"{words}, {BEYOND}" if words else ""


def _noun(kind: str, limb: Limb) -> str:
    return "force" if kind == "torque" and limb.unit == "m" else kind


def _limb(axes: Axes, tracks: Tracks, limb: Limb, kind: str) -> None:
    """Draw the joints' curves and the limits that they come near, hatched if all joints share them."""
    shown = [(i, axis) for i, axis in enumerate(limb.axes) if kind != "torque" or axis.torque is not None]
    drawn = [Curve(label=limb.short[i], values=partial(value, kind, axis), number=i) for i, axis in shown]
    draw.curves(axes, tracks, drawn)
    low, high = draw.fit(axes, least=LEAST_SPAN)
    limits = {limit_of(kind, axis) for _, axis in shown}
    near = {number: _limits_near(kind, axis, tracks) for number, axis in shown}
    every = {line for lines in near.values() for line in lines}
    draw.set_range(axes, min(low, *every, high), max(high, *every, low), LEAST_SPAN)
    if len(shown) < 2 or len(limits) > 1:
        for number, line in ((number, line) for number, lines in near.items() for line in lines):
            axes.axhline(line, **{**draw.LIMIT, "color": style.COLOURS[number]}, zorder=2)
        return
    (shared,), (bottom, top) = limits, axes.get_ylim()
    for line in every:
        axes.axhline(line, **draw.LIMIT, zorder=2)
        axes.axhspan(*sorted((line, bottom if line == shared[0] else top)), **draw.HATCHED)


def _limits_near(kind: str, axis: JointAxis, tracks: Tracks) -> list[float]:
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


def driven_axes(tracks: Tracks) -> list[tuple[JointAxis, Drive]]:
    """Axes with a drive."""
    drives = dict(enumerate(tracks[0].dense.drives))
    pairs = ((axis, None if axis.torque is None else drives.get(axis.torque)) for axis in tracks[0].axes)
    return [(axis, drive) for axis, drive in pairs if drive is not None]


def torque_share(axis: JointAxis, drive: Drive, motion: PlottedMotion) -> np.ndarray:
    """Motor torque over its limit (K,), equal to current over its limit; NaN without a limit."""
    if not np.isfinite(drive.torque_limit) or axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return np.abs(drive.motor_torque(motion.drive_torque[:, axis.torque])) / drive.torque_limit


def voltage_share(axis: JointAxis, drive: Drive, motion: PlottedMotion) -> np.ndarray:
    """Voltage over the largest voltage (K,); NaN without a voltage line."""
    if not np.isfinite(drive.stall_torque) or axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return np.abs(drive.voltage_use(motion.drive_torque[:, axis.torque], motion.rates[:, axis.torque]))


def drive_pages(tracks: Tracks) -> list[PlotPage]:
    """Shares of current and voltage over time, then every drive in its torque-speed plane."""
    driven = driven_axes(tracks)
    if not driven:
        return []
    rows: list[PlotRow] = []
    for number, part in enumerate(batches(driven, len(style.COLOURS))):
        for share, title in (
            (torque_share, "motor torque (current) over its limit"),
            (voltage_share, "motor voltage over its limit"),
        ):
            drawn = draw.numbered((axis.name, partial(share, axis, drive)) for axis, drive in part)
            if any(np.isfinite(curve.values(tracks[0].dense)).any() for curve in drawn):
                name = f"{share.__name__}:{number}"
                rows.append(draw.curve_row(name, title, "share [1]", drawn, draw.share_axis))
    panels = [
        PlotPanel(
            name=f"plane:{axis.name}",
            ylabel=f"{axis.name}  {'f [N]' if axis.slides else 'τ [N m]'}",
            draw=partial(_plane, axis=axis, drive=drive),
            title="" if number else "torque over speed, joint side",
        )
        for number, (axis, drive) in enumerate(driven)
    ]
    planes = [
        PlotRow(panels=part, timed=False, legend=False, height=1.5) for part in batches(panels, PLANES_A_ROW)
    ]
    note = (
        "Torque that the drive delivers, with joint friction. Shaded: what voltage and current allow. Dots: "
        "collocation points. Dashed red: the joint's velocity limit."
    )
    return page_of("drives", "drives", rows + planes[:2], *batches(planes[2:], ROWS_A_PAGE), note=note)


def _plane(axes: Axes, tracks: Tracks, axis: JointAxis, drive: Drive) -> None:
    row = axis.torque
    assert row is not None
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
    for number, track in enumerate(tracks):
        rates, torques = track.dense.rates[:, row], track.dense.drive_torque[:, row]
        axes.plot(rates, torques, linestyle=style.line_style(number), **look)
    points, at = tracks[0].points, tracks[0].points.solution.collocation
    axes.plot(points.rates[at, row], points.drive_torque[at, row], color=style.BLUE, **style.DOTTED)
    if far:
        axes.set_xlim(-end, end)
        axes.set_ylim(top=axes.get_ylim()[0] + 1.1 * np.ptp(axes.get_ylim()))  # room for the remark
        draw.remark_inside(axes, f"{limit_words('velocity', [axis])}, {BEYOND}")
    elif np.isfinite(axis.speed):
        for speed in (-axis.speed, axis.speed):
            axes.axvline(speed, **{**draw.LIMIT, "color": style.RED})
    axes.set_xlabel(f"rate [{axis.unit}/s]")
