"""The page about drives: shares of torque and voltage used, and operating points in their envelopes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.robot.actuators.drive import Drive
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.joints import JointAxis
from trajopt.view.plotting.motion import MotionQuantities
from trajopt.view.plotting.page import PlotPage, PlotPanel, PlotRow, Tracks, batches, page_of
from trajopt.view.plotting.quantities import BEYOND, limit_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLANES_A_ROW, ROWS_A_PAGE = 3, 4
# Points along an envelope, and how far it is drawn beyond the no-load speed or the motion.
ENVELOPE, MARGIN = 200, 1.1


def driven_axes(tracks: Tracks) -> list[tuple[JointAxis, Drive]]:
    """Axes with a drive."""
    drives = dict(enumerate(tracks[0].dense.drives))
    pairs = ((axis, None if axis.torque is None else drives.get(axis.torque)) for axis in tracks[0].axes)
    return [(axis, drive) for axis, drive in pairs if drive is not None]


def torque_share(axis: JointAxis, drive: Drive, motion: MotionQuantities) -> np.ndarray:
    """Motor torque over its limit (K,), equal to current over its limit; NaN without a limit."""
    if not np.isfinite(drive.torque_limit) or axis.torque is None:
        return np.full(len(motion.t), np.nan)
    return np.abs(drive.motor_torque(motion.drive_torque[:, axis.torque])) / drive.torque_limit


def voltage_share(axis: JointAxis, drive: Drive, motion: MotionQuantities) -> np.ndarray:
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
    far = unlimited and end > draw.FAR * fastest > 0
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
