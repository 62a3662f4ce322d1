"""Text on the page of a replay: title, and lines of the caption."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from trajopt.solution.solution import Solution
from trajopt.view.replay.arrows import FORCE_COLOUR, IMPULSE_COLOUR
from trajopt.view.replay.cones import COLOURS as CONE_COLOURS
from trajopt.view.replay.cones import USED
from trajopt.view.replay.controller import ASKED_COLOUR
from trajopt.view.replay.motion import FLASH, ReplayMotion
from trajopt.view.replay.runs import DrawnSolution

Line = dict[str, str]


def caption_lines(
    runs: Sequence[DrawnSolution],
    motions: Sequence[ReplayMotion],
    layers: Collection[str],
    weight_arrow: float,
    note: str,
) -> list[Line]:
    """Return the lines of the caption: solutions, legend of ``layers``, a ``note`` on missing parts.

    Kinds are "", "run", "quiet", "scale", "warned" or "failed"; ``weight_arrow`` is the length of a weight's
    arrow, m. A line with a layer is shown while the layer is.
    """
    notes = [caption_line(note, "warned")] if note else []
    legend = [line for line in _legend(motions, weight_arrow) if line["layer"] in layers]
    return [*_about(runs), *legend, *notes]


def title(solution: Solution) -> str:
    """Return problem and robot of a solution."""
    names = [solution.description.problem, solution.description.robot]
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
    if not solution.success:
        lines.append(caption_line(f"not solved: {solution.statistics.status.replace('_', ' ')}", "failed"))
    return lines


def solution_line(solution: Solution) -> str:
    """Return length, grid, objective and, where it was measured, the open-loop error of a solution."""
    statistics, graded = solution.statistics, solution.statistics.graded
    said = [f"{solution.t[-1] - solution.t[0]:.2f} s"]
    if statistics.simulated:
        said.append("simulated")
    elif statistics.transcription:
        said.append(f"{statistics.transcription}, {solution.n_intervals} intervals")
    if statistics.objective is not None:
        said.append(f"objective {statistics.objective:.4g}")
    if graded is not None and graded.error_m is not None:
        said.append(f"open-loop error {1e3 * graded.error_m:.2g} mm")
    return "; ".join(said)


def _legend(motions: Sequence[ReplayMotion], weight_arrow: float) -> list[Line]:
    """Scales of arrows, and the colours of cones.

    Several robots have a weight each, and arrows are in parts of it.
    """
    weights = dict.fromkeys(f"{motion.weight:.1f} N" for motion in motions)
    forces = f"forces: {weight_arrow:.2f} m is the weight, {' or '.join(weights)}"
    impulses = dict.fromkeys(f"{motion.weight * FLASH:.2f} N s" for motion in motions if motion.impact.any())
    struck = f"impulses: {weight_arrow:.2f} m is {' or '.join(impulses)}"
    ends = [f"#{colour:06x} {100 * used:.0f}%" for used, colour in zip(USED, CONE_COLOURS, strict=True)]
    cones = "cones: share of friction used, 0 to 100 %"
    asked = "controller: forces it asked for; crosses: its goals"
    return [
        caption_line(forces, "quiet", f"#{FORCE_COLOUR:06x}", "forces"),
        caption_line(asked, "quiet", f"#{ASKED_COLOUR:06x}", "controller"),
        caption_line(struck, "quiet", f"#{IMPULSE_COLOUR:06x}", "impulses"),
        caption_line(cones, "scale", f"linear-gradient(90deg, {', '.join(ends)})", "cones"),
    ]


def caption_line(text: str, kind: str = "", colour: str = "", layer: str = "") -> Line:
    """Return a line of the caption; ``colour`` as in CSS, also a gradient, ``layer``: whose legend it is."""
    return {"text": text, "kind": kind, "colour": colour, "layer": layer}
