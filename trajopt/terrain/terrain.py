"""Kinds of ground of a problem, and their description in a solution file."""

from typing import Any

from trajopt.arguments import checked
from trajopt.errors import InputError, shown
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import CurvedSurface, SmoothTerrain
from trajopt.terrain.surface import Surface

Terrain = FlatGround | PiecewiseTerrain | SmoothTerrain
# The ground that a contact touches: a plane, or smooth ground.
Ground = Surface | CurvedSurface


@checked
def terrain_from_description(described: Any) -> Terrain:
    """The terrain that ``describe`` wrote. Raises `InputError`."""
    kind = described.get("kind") if isinstance(described, dict) else described
    if kind == "piecewise":
        return PiecewiseTerrain.from_description(described)
    if kind == "smooth":
        return SmoothTerrain.from_description(described)
    if kind != "flat":
        raise InputError(f"terrain of kind {shown(kind)} is not known", "allowed: flat, piecewise, smooth")
    numbers = {key: described[key] for key in ("height", "normal", "friction") if key in described}
    try:
        return FlatGround(**numbers)
    except (TypeError, ValueError):
        raise InputError("flat terrain has no numeric height, normal and friction") from None
