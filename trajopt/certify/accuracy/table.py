"""Format accuracy as a table: one figure a line, the comparison with a reference, then the phases."""

from collections.abc import Mapping

import numpy as np

from trajopt.certify.accuracy.measures import Accuracy, PhaseAccuracy
from trajopt.certify.report import MeasuredFigure

# Text and unit of each figure.
FIGURES = {
    "open_loop": ("open loop by phase, position", "m"),
    "open_loop_orientation": ("open loop by phase, base orientation", "rad"),
    "open_loop_joints": ("open loop by phase, joints", "rad, m"),
    "open_loop_farthest": ("open loop by phase, farthest-off point", "m"),
    "open_loop_motion": ("open loop, whole motion, position", "m"),
    "open_loop_motion_orientation": ("open loop, whole motion, base orientation", "rad"),
    "open_loop_motion_joints": ("open loop, whole motion, joints", "rad, m"),
    "open_loop_motion_farthest": ("open loop, whole motion, farthest-off point", "m"),
    "interval_error": ("local error of one interval", "m"),
    "base_error": ("base rows of the dynamics between points", "weight, reach"),
    "actuated_error": ("actuated rows of the dynamics between points", "weight, reach"),
    "contact_error": ("acceleration of contacts between points", "g, reach"),
    "foot_drift": ("drift of active contacts between points", "m"),
    "violation_between": ("violation between points, natural units", "1"),
}
COMPARISON_FIGURES = {
    "objective_gap": ("objective against the reference", "relative"),
    "distance": ("position from the reference's", "m"),
    "farthest": ("farthest-off point from the reference's", "m"),
    "orientation": ("base orientation from the reference's", "rad"),
    "joints": ("joints from the reference's", "rad, m"),
    "torque": ("torques from the reference's", "weight, reach"),
    "torque_rms": ("torques from the reference's, mean square", "weight, reach"),
    "time": ("duration of a phase from the reference's", "s"),
}


def accuracy_figures(accuracy: Accuracy) -> list[MeasuredFigure]:
    """Return the figures that were measured, without the comparison with a reference."""
    return _known(accuracy, FIGURES)


def accuracy_table(accuracy: Accuracy) -> str:
    """Return figures with units; None is left out, and nonzero violations are listed by name."""
    figures = accuracy_figures(accuracy)
    figures += [
        MeasuredFigure(text=f"  {name.replace('_', ' ')}", value=value, unit="1")
        for name, value in accuracy.violations.items()
        if value
    ]
    if accuracy.comparison is not None:
        figures += _known(accuracy.comparison, COMPARISON_FIGURES)
    worst = int(np.argmax(accuracy.interval_errors))
    lines = [figure.line(46) for figure in figures]
    lines.append(f"interval {worst} of {len(accuracy.interval_errors)} has the largest local error")
    return "\n".join([*lines, *(_phase(phase) for phase in accuracy.phases)])


def _known(measured: object, named: Mapping[str, tuple[str, str]]) -> list[MeasuredFigure]:
    return [
        MeasuredFigure(text=text, value=value, unit=unit)
        for name, (text, unit) in named.items()
        if (value := getattr(measured, name)) is not None
    ]


def _phase(phase: PhaseAccuracy) -> str:
    parts = [
        f"open loop {phase.open_loop.position:.1e} m",
        f"in the whole motion {phase.motion.position:.1e} m",
        f"local {phase.interval_error:.1e} m",
        f"rows between {phase.collocation_error:.1e}",
    ]
    if phase.distance is not None:
        parts.append(f"from the reference {phase.distance:.1e} m")
    return f"phase '{phase.name}' ({phase.start:.3f} to {phase.end:.3f} s): {', '.join(parts)}"
