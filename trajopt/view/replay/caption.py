"""Text on the page of a replay: title, and lines of the caption."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trajopt.solution.solution import Solution
from trajopt.view.replay.arrows import FORCE_COLOUR, IMPULSE_COLOUR
from trajopt.view.replay.motion import FLASH, ReplayMotion
from trajopt.view.replay.runs import DrawnSolution

Line = dict[str, str]


def caption_lines(
    runs: Sequence[DrawnSolution], motions: Sequence[ReplayMotion], weight_arrow: float, note: str
) -> list[Line]:
    """Return the lines of the caption: solutions, scales of arrows, and a ``note`` on missing parts.

    Kinds are "", "run", "quiet", "warned" or "failed"; ``weight_arrow`` is the length of a weight's arrow, m.
    """
    notes = [caption_line(note, "warned")] if note else []
    return [*_about(runs), *_scales(motions, weight_arrow), *notes]


def title(solution: Solution) -> str:
    """Return problem and robot of a solution."""
    names = [solution.meta.get("problem"), solution.meta.get("robot")]
    return " – ".join(dict.fromkeys(str(name) for name in names if name)) or "trajectory"


def _about(runs: Sequence[DrawnSolution]) -> list[Line]:
    if len(runs) == 1:
        return _state(runs[0].solution)
    names, lines = [title(run.solution) for run in runs], []
    for run, name in zip(runs, names, strict=True):
        usual = name.replace(" – ", " ")  # the default label of a run
        told = len(set(names)) == 1 or run.label == usual
        said = run.label if told else f"{run.label}: {name}"
        lines += [caption_line(said, "run", f"#{run.colour:06x}"), *_state(run.solution)]
    return lines


def _state(solution: Solution) -> list[Line]:
    lines = [caption_line(solution_line(solution), "quiet")]
    if not solution.meta.get("success", True):
        lines.append(
            caption_line(f"not solved: {str(solution.meta.get('status')).replace('_', ' ')}", "failed")
        )
    return lines


def solution_line(solution: Solution) -> str:
    """Return length, grid, objective and, where it was measured, the open-loop error of a solution."""
    meta = solution.meta
    said = [f"{solution.t[-1] - solution.t[0]:.2f} s"]
    if meta.get("simulated"):
        said.append("simulated")
    elif meta.get("transcription"):
        said.append(f"{meta['transcription']}, {solution.n_intervals} intervals")
    if _is_finite(meta.get("objective")):
        said.append(f"objective {meta['objective']:.4g}")
    measured = meta.get("aimed") or meta.get("refinement") or meta.get("graded") or {}
    if _is_finite(measured.get("error_m")):
        said.append(f"open-loop error {1e3 * measured['error_m']:.2g} mm")
    return "; ".join(said)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _scales(motions: Sequence[ReplayMotion], weight_arrow: float) -> list[Line]:
    """Scales of arrows; several robots have a weight each, and arrows are in parts of it."""
    lines = []
    weights = dict.fromkeys(f"{motion.weight:.1f} N" for motion in motions)
    if any(motion.force.shape[1] for motion in motions):
        text = f"forces: {weight_arrow:.2f} m is the weight, {' or '.join(weights)}"
        lines.append(caption_line(text, "quiet", f"#{FORCE_COLOUR:06x}"))
    struck = [motion for motion in motions if motion.impact.any()]
    if struck:
        scales = dict.fromkeys(f"{motion.weight * FLASH:.2f} N s" for motion in struck)
        text = f"impulses: {weight_arrow:.2f} m is {' or '.join(scales)}"
        lines.append(caption_line(text, "quiet", f"#{IMPULSE_COLOUR:06x}"))
    return lines


def caption_line(text: str, kind: str = "", colour: str = "") -> Line:
    """Return a line of the caption."""
    return {"text": text, "kind": kind, "colour": colour}
