"""Terrain from a line of text, such as ``stairs:rise=0.1,run=0.3,steps=3``, or from a JSON file."""

from __future__ import annotations

import ast
import inspect
import json
from typing import Any

from trajopt.errors import InputError, expanded, not_among
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.terrain import Terrain, terrain_from_description

# Constructors of `PiecewiseTerrain`.
KINDS = ("steps", "stairs", "box", "gap", "slope", "stepping_stones")


def read_terrain(text: str, begin: float) -> Terrain:
    """The terrain of a text ``KIND:NAME=VALUE,...`` or of a file with the description of one.

    Args:
        text: one of `KINDS` with its arguments, or a ``.json`` file.
        begin: x at which it begins, m, if the text has no ``at``.

    Raises:
        InputError: for an unreadable file, an unknown kind, and arguments that do not fit.
    """
    if text.endswith(".json"):
        path = expanded(text)
        try:
            return terrain_from_description(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{path} cannot be read: {error}", "allowed: terrain.describe() in JSON"
            ) from None
    kind, _, given = text.partition(":")
    if kind not in KINDS:
        raise not_among((*KINDS, "FILE.json"), kind, f"--terrain is '{text}'")
    make, values = getattr(PiecewiseTerrain, kind), _values(kind, given)
    names = list(inspect.signature(make).parameters)
    try:
        if "at" in names:
            half = values["length"] / 2 if kind == "box" else 0.0
            values.setdefault("at", (begin + half, 0.0))
        inspect.signature(make).bind(**values)
    except (KeyError, TypeError):
        allowed = f"allowed: {kind}:NAME=VALUE,... of {', '.join(names)}"
        raise InputError(f"--terrain '{text}' has the wrong form", allowed) from None
    terrain: PiecewiseTerrain = make(**values)
    return terrain


def _values(kind: str, given: str) -> dict[str, Any]:
    """Values by name of ``NAME=VALUE,...``; lists are in brackets."""
    try:
        call = ast.parse(f"kind({given})", mode="eval").body
        if not isinstance(call, ast.Call) or call.args:
            raise ValueError(given)
        return {str(each.arg): ast.literal_eval(each.value) for each in call.keywords}
    except (SyntaxError, ValueError):
        raise InputError(f"--terrain {kind} has '{given}'", "allowed: NAME=NUMBER,... or [NUMBERS]") from None
