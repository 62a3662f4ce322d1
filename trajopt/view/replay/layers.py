"""Text and layers of a replay's page: its title, the lines of its caption, and what it can show and hide."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.solution.solution import Solution
from trajopt.view.replay.balance import SUPPORT_COLOUR, ZMP_COLOUR
from trajopt.view.replay.bodies import OBSTACLE_COLOUR, PAYLOAD_COLOUR, SHAPE_COLOUR
from trajopt.view.replay.contacts import COLOURS as CONE_COLOURS
from trajopt.view.replay.contacts import FORCE_COLOUR, IMPULSE_COLOUR, USED
from trajopt.view.replay.goals import ASKED_COLOUR, CROSS_COLOUR
from trajopt.view.replay.ground import GROUND_COLOUR
from trajopt.view.replay.motion import FLASH, ReplayMotion
from trajopt.view.replay.runs import GHOST_COLOUR, DrawnSolution, travels
from trajopt.view.replay.surfaces import WALL_COLOUR

Line = dict[str, str]
# A robot ends elsewhere if its base moves by more than this, over its extent.
ELSEWHERE = 0.5

# Name, label, colour, and place in the scene tree of every run or of the scene.
LAYERS = (
    ("robot", "robot", 0x8A93A0, "robot"),
    ("shapes", "collision shapes", SHAPE_COLOUR, "shapes"),
    ("forces", "contact forces", FORCE_COLOUR, "forces"),
    ("controller", "controller: forces and goals", ASKED_COLOUR, "controller"),
    ("impulses", "impulses", IMPULSE_COLOUR, "impulses"),
    ("cones", "friction cones", 0x3C93C2, "cones"),
    ("com", "centre of mass", 0x1A1F26, "com"),
    ("zmp", "zero-moment point", ZMP_COLOUR, "zmp"),
    ("support", "support", SUPPORT_COLOUR, "support"),
    ("trails", "trails", 0x1F77B4, "trails"),
    ("ghosts", "poses at changes of phase", GHOST_COLOUR, "ghosts"),
    ("goals", "goals", CROSS_COLOUR, "goals"),
    ("payloads", "payload", PAYLOAD_COLOUR, "payloads"),
    ("obstacles", "obstacles", OBSTACLE_COLOUR, "obstacles"),
    ("surfaces", "walls and handles", WALL_COLOUR, "surfaces"),
    ("terrain", "terrain", GROUND_COLOUR, "ground"),
)


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
    """The caption's lines about the solutions, with labels if there are several."""
    names, lines = [title(run.solution) for run in runs], []
    for run, name in zip(runs, names, strict=True):
        if len(runs) > 1:
            usual = name.replace(" – ", " ")  # the default label of a run
            told = len(set(names)) == 1 or run.label == usual
            said = run.label if told else f"{run.label}: {name}"
            lines.append(caption_line(said, "run", f"#{run.colour:06x}"))
        lines.append(caption_line(_state(run.solution), "quiet"))
        if not run.solution.success:
            status = run.solution.statistics.status.replace("_", " ")
            lines.append(caption_line(f"not solved: {status}", "failed"))
    return lines


def _state(solution: Solution) -> str:
    """Length, grid, objective and, where it was measured, the open-loop error of a solution."""
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
    """Scales of arrows in terms of each robot's weight, and the colours of cones."""
    weights = dict.fromkeys(f"{motion.weight:.1f} N" for motion in motions)
    forces = f"forces: {weight_arrow:.2f} m is the weight, {' or '.join(weights)}"
    impulses = dict.fromkeys(
        f"{motion.weight * FLASH:.2f} N s" for motion in motions if motion.impact[..., :3].any()
    )
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


def layers_of(
    runs: Sequence[DrawnSolution], drawn: Collection[str], tangents: np.ndarray
) -> list[dict[str, Any]]:
    """The layers with something ``drawn`` (scene tree paths), and one for each run if there are several.

    ``tangents`` (2, 3) are those of the ground. Collision shapes are hidden at first, and so are ghosts
    unless they show the path of a single robot at a glance: both obscure the robot. The centre of mass is
    hidden for fixed bases, where it is of little interest.
    """
    hidden = {"shapes"}
    if len(runs) > 1 or not _parts_from_itself(runs[0], tangents):
        hidden.add("ghosts")
    if not any(BASE_JOINT[base_of(run.solution.model)] for run in runs):
        hidden.add("com")
    places = {"/".join(path.split("/")[:depth]) for path in drawn for depth in range(1, path.count("/") + 2)}
    listed = []
    for name, label, colour, place in LAYERS:
        wanted = [*(run.path(place) for run in runs), place]
        paths = [path for path in dict.fromkeys(wanted) if path in places]
        if paths:
            listed.append(layer(name, label, colour, paths, name not in hidden))
    if len(runs) > 1:
        listed += [layer(run.root, run.label, run.colour, [run.root]) for run in runs]
    return listed


def layer(name: str, label: str, colour: int, paths: list[str], visible: bool = True) -> dict[str, Any]:
    """Return a layer for the page: a toggle that shows and hides parts of the scene tree."""
    return {"name": name, "label": label, "colour": f"#{colour:06x}", "paths": paths, "visible": visible}


def _parts_from_itself(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the robot ends away from its start but within one picture; always true for a fixed base."""
    if not BASE_JOINT[base_of(run.solution.model)]:
        return True
    way = float(np.linalg.norm((run.base[-1] - run.base[0]) @ tangents.T))
    return way > ELSEWHERE * run.size and not travels(run, tangents)
