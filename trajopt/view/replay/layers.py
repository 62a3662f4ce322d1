"""The layers of a scene: what a viewer can show and hide: names, colours, places in the scene tree."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.view.replay.balance_marks import SUPPORT_COLOUR, ZMP_COLOUR
from trajopt.view.replay.copies import GHOST_COLOUR
from trajopt.view.replay.goals import CROSS_COLOUR
from trajopt.view.replay.payloads import PAYLOAD_COLOUR
from trajopt.view.replay.runs import DrawnSolution, travels


@dataclass(frozen=True)
class Layer:
    """What one toggle shows: the parts at ``places`` of every run or of the scene."""

    name: str
    label: str
    colour: int
    places: tuple[str, ...]


# A robot ends elsewhere if its base is this part of its extent from where it began.
ELSEWHERE = 0.5

LAYERS = (
    Layer("robot", "robot", 0x8A93A0, ("robot",)),
    Layer("forces", "contact forces", 0xD9421F, ("forces",)),
    Layer("impulses", "impulses", 0x7A1FA2, ("impulses",)),
    Layer("cones", "friction cones", 0x3C93C2, ("cones",)),
    Layer("com", "centre of mass", 0x1A1F26, ("com",)),
    Layer("zmp", "zero-moment point", ZMP_COLOUR, ("zmp",)),
    Layer("support", "support", SUPPORT_COLOUR, ("support",)),
    Layer("trails", "trails", 0x1F77B4, ("trails",)),
    Layer("ghosts", "poses at changes of phase", GHOST_COLOUR, ("ghosts",)),
    Layer("goals", "goals", CROSS_COLOUR, ("goals",)),
    Layer("payloads", "payload", PAYLOAD_COLOUR, ("payloads",)),
    Layer("obstacles", "obstacles", 0xC1553B, ("obstacles",)),
    Layer("surfaces", "walls and handles", 0xB98A4E, ("surfaces",)),
    Layer("terrain", "terrain", 0xDCE1E8, ("ground",)),
)


def layers_of(
    runs: Sequence[DrawnSolution], drawn: Collection[str], hidden: Collection[str]
) -> list[dict[str, Any]]:
    """The layers of which something is ``drawn`` (scene tree paths), and one for each of several runs.

    ``hidden``: names of those that are not shown at first.
    """
    places = {"/".join(path.split("/")[:depth]) for path in drawn for depth in range(1, path.count("/") + 2)}
    found = []
    for layer in LAYERS:
        wanted = [run.path(place) for run in runs for place in layer.places] + list(layer.places)
        paths = [path for path in dict.fromkeys(wanted) if path in places]
        if paths:
            found.append(_described(layer.name, layer.label, layer.colour, paths, layer.name not in hidden))
    if len(runs) > 1:
        found += [_described(run.root, run.label, run.colour, [run.root], True) for run in runs]
    return found


def hidden_layers(runs: Sequence[DrawnSolution], tangents: np.ndarray) -> set[str]:
    """Names of the layers that a first look does without; ``tangents`` (2, 3) of the ground.

    Ghosts show a way at a glance where the robot leaves its place; over each other, or beside a second
    robot, they hide more than they show. The centre of mass says little of a robot that is bolted down.
    """
    hidden = set()
    if len(runs) > 1 or not _parts_from_itself(runs[0], tangents):
        hidden.add("ghosts")
    if not any(BASE_JOINT[base_of(run.solution.model)] for run in runs):
        hidden.add("com")
    return hidden


def _parts_from_itself(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the robot ends elsewhere, but in one picture: an arm always."""
    if not BASE_JOINT[base_of(run.solution.model)]:
        return True
    way = float(np.linalg.norm((run.base[-1] - run.base[0]) @ tangents.T))
    return way > ELSEWHERE * run.size and not travels(run, tangents)


def _described(name: str, label: str, colour: int, paths: list[str], visible: bool) -> dict[str, Any]:
    return {
        "name": name,
        "label": label,
        "colour": f"#{colour:06x}",
        "paths": paths,
        "visible": visible,
    }
