"""The layers of a scene that a viewer can show and hide: names, colours, scene tree paths."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.view.replay.arrows import FORCE_COLOUR, IMPULSE_COLOUR
from trajopt.view.replay.balance_marks import SUPPORT_COLOUR, ZMP_COLOUR
from trajopt.view.replay.bodies import OBSTACLE_COLOUR, PAYLOAD_COLOUR
from trajopt.view.replay.controller import ASKED_COLOUR
from trajopt.view.replay.copies import GHOST_COLOUR
from trajopt.view.replay.goals import CROSS_COLOUR
from trajopt.view.replay.ground import GROUND_COLOUR
from trajopt.view.replay.links import PLACE as SHAPES
from trajopt.view.replay.links import SHAPE_COLOUR
from trajopt.view.replay.runs import DrawnSolution, travels
from trajopt.view.replay.surfaces import WALL_COLOUR

# A robot ends elsewhere if its base moves by more than this, over its extent.
ELSEWHERE = 0.5

# Name, label, colour, and place in the scene tree of every run or of the scene.
LAYERS = (
    ("robot", "robot", 0x8A93A0, "robot"),
    ("shapes", "collision shapes", SHAPE_COLOUR, SHAPES),
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


def layers_of(
    runs: Sequence[DrawnSolution], drawn: Collection[str], hidden: Collection[str]
) -> list[dict[str, Any]]:
    """The layers with something ``drawn`` (scene tree paths), and one for each of several runs.

    ``hidden``: names of those hidden at first.
    """
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
    """Return a layer's description for the page: the parts of the scene tree that one toggle shows."""
    return {"name": name, "label": label, "colour": f"#{colour:06x}", "paths": paths, "visible": visible}


def hidden_layers(runs: Sequence[DrawnSolution], tangents: np.ndarray) -> set[str]:
    """Names of the layers that are hidden at first; ``tangents`` (2, 3) of the ground.

    Ghosts show the path at a glance if the robot travels; over each other, or beside a second robot, they
    obscure more than they show, and so do collision shapes. The centre of mass is of little interest for a
    fixed base.
    """
    hidden = {"shapes"}
    if len(runs) > 1 or not _parts_from_itself(runs[0], tangents):
        hidden.add("ghosts")
    if not any(BASE_JOINT[base_of(run.solution.model)] for run in runs):
        hidden.add("com")
    return hidden


def _parts_from_itself(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the robot ends elsewhere, within one picture; always true for an arm."""
    if not BASE_JOINT[base_of(run.solution.model)]:
        return True
    way = float(np.linalg.norm((run.base[-1] - run.base[0]) @ tangents.T))
    return way > ELSEWHERE * run.size and not travels(run, tangents)
