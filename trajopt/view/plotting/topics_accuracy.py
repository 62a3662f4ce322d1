"""The topic of errors: residuals between the collocation points, local errors, widths of the mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajopt.motion.grid import interval_schemes
from trajopt.view.plotting import sheet as plot
from trajopt.view.plotting import style
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.sheet import Sheet
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Below this, natural units or m, a residual is rounding: the logarithmic axes end here.
FLOOR = 1e-12
# Fewest decades of a logarithmic axis.
DECADES = 3
# Height of an empty panel, inches.
EMPTY = 0.4


def draw_accuracy(sheet: Sheet) -> None:
    """Draw residuals, violations, local errors and mesh of solutions that are plans."""
    draw_residuals(sheet)
    violations = {label: partial(largest_violation, of=values) for label, values in VIOLATIONS.items()}
    _draw_logarithms(sheet, violations, "violation", "constraints broken")
    plans = [track for track in sheet.tracks if track.is_plan]
    if not plans:
        return
    axes = sheet.panel("local error", "local error of every interval", "error [m]", legend=False)
    for track in plans:
        errors = track.local_errors
        _draw_steps(axes, track, np.where(np.isfinite(errors), np.maximum(errors, FLOOR), np.nan))
        middle = track.solution.interval_t.mean(axis=1)[np.isinf(errors)]
        top = np.full(len(middle), 0.97)
        axes.plot(middle, top, "^", color=style.RED, transform=axes.get_xaxis_transform())
    fit_logarithm(axes)
    points = [sorted({len(method.c) for method in interval_schemes(track.solution)}) for track in plans]
    listed = "; ".join(", ".join(map(str, counts)) for counts in points)
    title = f"mesh: width of every interval, {listed} points in each"
    axes = sheet.panel("mesh", title, "width h [ms]", legend=False)
    for track in plans:
        _draw_steps(axes, track, 1e3 * np.diff(track.solution.interval_t, axis=1)[:, 0])
    plot.fit(axes, zero=True)
    sheet.notes.append(
        "Residuals: base and actuated rows over weight and reach, accelerations of contacts over g. They "
        "vanish at the collocation points, dots, up to the solver's tolerance. Local error: each interval "
        "integrated from its planned start, largest error of a point of the robot at its end."
    )


def draw_residuals(sheet: Sheet) -> None:
    """Draw residuals of the dynamics between the points of plans, on a logarithmic axis."""
    _draw_logarithms(sheet, RESIDUALS, "residual", "dynamics")


def _draw_logarithms(sheet: Sheet, named: Mapping[str, MotionQuantity], name: str, what: str) -> None:
    plans = [track for track in sheet.tracks if track.is_plan]
    if not plans:
        return
    named = {label: partial(_above_floor, values) for label, values in named.items()}
    known = any(np.isfinite(of(track.dense)).any() for of in named.values() for track in plans)
    title = f"{what} between the collocation points{'' if known else ': none'}"
    axes = sheet.panel(name, title, f"{name} [1]", height=None if known else EMPTY)
    plot.curves(axes, plans, named, dots=False, linewidth=0.9)
    fit_logarithm(axes)
    points = plans[0].solution.t[plans[0].solution.collocation]  # along the lower edge
    low, look = np.full(len(points), 0.012), {"color": style.BLACK, **style.DOTTED}
    axes.plot(points, low, transform=axes.get_xaxis_transform(), clip_on=False, zorder=3.5, **look)


def _above_floor(values: MotionQuantity, motion: PlottedMotion) -> np.ndarray:
    """Values above `FLOOR`, NaN below it."""
    rows = values(motion)
    return np.where(rows > FLOOR, rows, np.nan)


def dynamics_residual(motion: PlottedMotion, part: str) -> np.ndarray:
    """Largest residual (K,) of the "base" or "actuated" rows of the dynamics, over weight and reach."""
    plan, rows = motion.solution, getattr(motion.residuals, part)
    scale = motion.units.generalized_force(plan.model)
    return _largest(rows / scale[plan.unactuated_rows if part == "base" else plan.actuated_rows])


def contact_residual(motion: PlottedMotion) -> np.ndarray:
    """Largest acceleration of active contacts (K,) over g; with velocity sources, velocity over sqrt(g l)."""
    units, turning = motion.units, np.array([1.0] * 3 + [1.0 / motion.units.length] * 3)
    is_statics = motion.moved_by_rates
    scale = math.sqrt(units.gravity * units.length) if is_statics else units.gravity
    rows = motion.residuals.contact / (scale * turning)
    return _largest(rows.reshape(len(rows), -1))


def _largest(rows: np.ndarray) -> np.ndarray:
    return np.abs(rows).max(axis=1, initial=0.0)


RESIDUALS: dict[str, MotionQuantity] = {
    "base": partial(dynamics_residual, part="base"),
    "actuated": partial(dynamics_residual, part="actuated"),
    "contacts": contact_residual,
}
# Constraint violations (K, n), positive where violated: forces over the weight (tangential ones beyond the
# cone, pulling unilateral ones), depths over the reach, the rest over its limits.
VIOLATIONS: dict[str, MotionQuantity] = {
    "friction": lambda m: (m.tangential - m.cone) / m.units.weight,
    "pull": lambda m: np.where(m.surfaces.bilateral, np.nan, -m.normal) / m.units.weight,
    "penetration": lambda m: -m.surface_distance / m.units.length,
    "torque": lambda m: m.limit_traces["effort_excess"].badness,
    "velocity": lambda m: m.limit_traces["velocity_excess"].badness,
    "position": lambda m: m.limit_traces["position_excess"].badness,
}


def largest_violation(motion: PlottedMotion, of: MotionQuantity) -> np.ndarray:
    """The largest positive value (K,) of a quantity (K, n); zero if there is none."""
    values = of(motion)
    return np.nanmax(np.where(np.isfinite(values), values, 0.0), axis=1, initial=0.0)


def fit_logarithm(axes: Axes) -> None:
    """Fit a logarithmic axis to the lines, at least `DECADES`; write "none" if all values are rounding."""
    from matplotlib.ticker import LogLocator, NullLocator

    values = plot.drawn_values(axes)
    values = values[values > FLOOR]
    axes.set_yscale("log")
    if not values.size:
        axes.set_ylim(FLOOR, FLOOR * 10**DECADES)
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color=style.GREY)
        return
    top = math.ceil(math.log10(values.max()) + 0.1)
    bottom = max(math.floor(math.log10(np.percentile(values, 2)) - 0.1), math.log10(FLOOR))
    axes.set_ylim(10.0 ** min(bottom, top - DECADES), 10.0**top)
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def _draw_steps(axes: Axes, track: Track, values: np.ndarray) -> None:
    """Draw a horizontal line for every interval, without ramps between them."""
    edges = track.solution.interval_t
    gaps = np.full(len(values), np.nan)
    t = np.column_stack([edges, edges[:, 1]]).ravel()
    y = np.column_stack([values, values, gaps]).ravel()
    look = {"color": style.colour(track.number), "linestyle": track.line_style}
    axes.plot(t, y, linewidth=1.2, label="interval", **look)
