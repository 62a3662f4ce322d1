"""The layers of a scene: what a viewer can show and hide: names, colours, places in the scene tree."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from trajopt.replay.runs import Run


@dataclass(frozen=True)
class Layer:
    """What one toggle shows: the parts at ``places`` of every run or of the scene; ``visible`` at first."""

    name: str
    label: str
    colour: int
    places: tuple[str, ...]
    visible: bool = True


LAYERS = (
    Layer("robot", "robot", 0x8A93A0, ("robot",)),
    Layer("forces", "contact forces", 0xD9421F, ("forces",)),
    Layer("impulses", "impulses", 0x7A1FA2, ("impulses",)),
    Layer("trails", "trails of feet", 0x1F77B4, ("trails",)),
    Layer("obstacles", "obstacles", 0xC1553B, ("obstacles",)),
    Layer("surfaces", "walls and handles", 0xB98A4E, ("surfaces",)),
    Layer("terrain", "terrain", 0xDCE1E8, ("ground",)),
)


def layers_of(runs: Sequence[Run], drawn: Collection[str]) -> list[dict[str, Any]]:
    """The layers of which something is ``drawn`` (scene tree paths), and one for each of several runs."""
    places = {"/".join(path.split("/")[:depth]) for path in drawn for depth in range(1, path.count("/") + 2)}
    found = []
    for layer in LAYERS:
        wanted = [run.path(place) for run in runs for place in layer.places] + list(layer.places)
        paths = [path for path in dict.fromkeys(wanted) if path in places]
        if paths:
            found.append(_described(layer.name, layer.label, layer.colour, paths, layer.visible))
    if len(runs) > 1:
        found += [_described(run.root, run.label, run.colour, [run.root], True) for run in runs]
    return found


def _described(name: str, label: str, colour: int, paths: list[str], visible: bool) -> dict[str, Any]:
    return {
        "name": name,
        "label": label,
        "colour": f"#{colour:06x}",
        "paths": paths,
        "visible": visible,
    }
