"""The page about errors: residuals between the collocation points, local errors, widths of the mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.solution.grid import interval_schemes
from trajopt.view.plotting import draw, style
from trajopt.view.plotting.draw import Curve, PlotPage, PlotRow, Tracks, page_of, panel_row
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.plotting.track import MotionQuantity, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Below this, natural units or m, a residual is rounding: the logarithmic axes end here.
FLOOR = 1e-12
# Fewest decades of a logarithmic axis.
DECADES = 3


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


def accuracy_pages(tracks: Tracks) -> list[PlotPage]:
    """Return residuals, violations, local errors and mesh of solutions that are plans."""
    rows = [residual_row(tracks), violation_row(tracks), local_row(tracks), mesh_row(tracks)]
    note = (
        "Residuals: base and actuated rows over weight and reach, accelerations of contacts over g. They "
        "vanish at the collocation points, dots, up to the solver's tolerance. Local error: each interval "
        "integrated from its planned start, largest error of a point of the robot at its end."
    )
    return page_of("accuracy", "errors between points", rows, note=note)


def plans(tracks: Tracks) -> list[tuple[int, Track]]:
    """Return the solutions that are plans, with their numbers: simulated motions have no points."""
    return [(number, track) for number, track in enumerate(tracks) if track.is_plan]


def residual_row(tracks: Tracks) -> PlotRow | None:
    """Residuals of the dynamics between the points on a logarithmic axis."""
    return _log_row(tracks, RESIDUALS, "residual", "dynamics")


def violation_row(tracks: Tracks) -> PlotRow | None:
    """Constraint violations between the points."""
    named = {label: partial(largest_violation, of=values) for label, values in VIOLATIONS.items()}
    return _log_row(tracks, named, "violation", "constraints broken")


def _log_row(tracks: Tracks, named: Mapping[str, MotionQuantity], name: str, what: str) -> PlotRow | None:
    shown = plans(tracks)
    if not shown:
        return None
    drawn = [
        replace(curve, values=partial(_floored, curve.values))
        for curve in draw.numbered(named.items(), dots=False, width=0.9)
        if any(curve.values(track.dense).max(initial=0.0) > FLOOR for _, track in shown)
    ]
    title = f"{what} between the collocation points{'' if drawn else ': none'}"
    scale = partial(_log, drawn=drawn)
    return panel_row(name, title, f"{name} [1]", scale, height=1.0 if drawn else 0.4)


def _floored(values: MotionQuantity, motion: PlottedMotion) -> np.ndarray:
    """Values above `FLOOR`, NaN below it."""
    rows = values(motion)
    return np.where(rows > FLOOR, rows, np.nan)


def _log(axes: Axes, tracks: Tracks, drawn: Sequence[Curve]) -> None:
    draw.curves(axes, tracks, drawn, plans_only=True)
    log_range(axes)
    solution = plans(tracks)[0][1].solution
    points = solution.t[solution.collocation]  # along the lower edge
    look: dict[str, Any] = {"color": style.BLACK, "clip_on": False, "zorder": 3.5, **style.DOTTED}
    axes.plot(points, np.full(len(points), 0.012), transform=axes.get_xaxis_transform(), **look)


def log_range(axes: Axes) -> None:
    """Fit a logarithmic axis to the lines, at least `DECADES`; write "none" if all values are rounding."""
    from matplotlib.ticker import LogLocator, NullLocator

    values = draw.drawn_values(axes)
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


def local_row(tracks: Tracks) -> PlotRow | None:
    """Return the local error of every interval on a logarithmic axis."""
    if not plans(tracks):
        return None
    return panel_row("local error", "local error of every interval", "error [m]", _local, legend=False)


def _local(axes: Axes, tracks: Tracks) -> None:
    for number, track in plans(tracks):
        errors = track.local_errors
        _steps(axes, track, np.where(np.isfinite(errors), np.maximum(errors, FLOOR), np.nan), number)
        middle = track.solution.interval_t.mean(axis=1)[np.isinf(errors)]
        top = np.full(len(middle), 0.97)
        axes.plot(middle, top, "^", color=style.RED, transform=axes.get_xaxis_transform())
    log_range(axes)


def mesh_row(tracks: Tracks) -> PlotRow | None:
    """Return the width of every interval."""
    shown = plans(tracks)
    if not shown:
        return None
    points = [sorted({len(method.c) for method in interval_schemes(track.solution)}) for _, track in shown]
    listed = "; ".join(", ".join(map(str, counts)) for counts in points)
    title = f"mesh: width of every interval, {listed} points in each"
    return panel_row("mesh", title, "width h [ms]", _mesh, height=0.7, legend=False)


def _mesh(axes: Axes, tracks: Tracks) -> None:
    for number, track in plans(tracks):
        _steps(axes, track, 1e3 * np.diff(track.solution.interval_t, axis=1)[:, 0], number)
    draw.fit(axes, zero=True)


def _steps(axes: Axes, track: Track, values: np.ndarray, number: int) -> None:
    """Draw a horizontal line for every interval, without ramps between them."""
    edges = track.solution.interval_t
    gaps = np.full(len(values), np.nan)
    t = np.column_stack([edges, edges[:, 1]]).ravel()
    y = np.column_stack([values, values, gaps]).ravel()
    look = {"color": style.colour(number), "linestyle": style.line_style(number)}
    axes.plot(t, y, linewidth=1.2, label="interval", **look)
