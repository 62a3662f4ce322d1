"""What the meta of a solution describes: surfaces, patches, terrain, and the scene of collisions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from trajopt.collision.description import RobotShapes
from trajopt.collision.near import CollisionScene
from trajopt.collision.shapes import LinkShape, obstacle_from_description
from trajopt.errors import InputError, SolutionFileError
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import UP, Surface
from trajopt.terrain.terrain import terrain_from_description

_Read = TypeVar("_Read")
GroundShape = Surface | PiecewiseTerrain | SmoothTerrain


def surfaces_of(described: Any) -> list[dict[str, Surface]]:
    """Read ``meta["surfaces"]``: for each phase the surfaces of active contacts, by their frames.

    Empty where all contacts touch the terrain. Raises `SolutionFileError`.
    """
    return _by_phase("surfaces", "surface", described, Surface.from_description)


def patches_of(described: Any) -> list[dict[str, Patch]]:
    """Read ``meta["patches"]``: for each phase the patches on which active contacts stand, by their frames.

    Empty where there are none. Raises `SolutionFileError`.
    """
    return _by_phase("patches", "patch", described, Patch.from_description)


def _by_phase(key: str, entry: str, described: Any, read: Callable[[Any], _Read]) -> list[dict[str, _Read]]:
    if described is None:
        return []
    if not isinstance(described, list) or not all(isinstance(phase, dict) for phase in described):
        raise SolutionFileError(f"{key} of meta is not null or a list of {{contact frame: {entry}}}")
    try:
        return [{str(frame): read(given) for frame, given in phase.items()} for phase in described]
    except InputError as error:
        raise SolutionFileError(f"{key} of meta: {error.what}", error.allowed) from None


def terrain_of(described: Any) -> GroundShape | None:
    """Read ``meta["terrain"]``; None where there is none. Raises `SolutionFileError` for another kind."""
    kind = described.get("kind") if isinstance(described, dict) else described
    if kind not in ("piecewise", "smooth"):
        return terrain_surface(described)
    try:
        return (PiecewiseTerrain if kind == "piecewise" else SmoothTerrain).from_description(described)
    except InputError as error:
        raise SolutionFileError(f"terrain in meta: {error.what}", error.allowed) from None


def terrain_surface(terrain: Any) -> Surface | None:
    """Read flat ground of ``meta["terrain"]``, None where there is none. Raises `SolutionFileError`."""
    if terrain is None:
        return None
    if not isinstance(terrain, dict) or terrain.get("kind") != "flat":
        kind = terrain.get("kind") if isinstance(terrain, dict) else terrain
        raise SolutionFileError(
            f"terrain of kind {kind!r} in meta is not known",
            "'flat', 'piecewise', 'smooth' or null",
        )
    try:
        height = float(terrain.get("height", 0.0))
        return Surface(point=np.array([0.0, 0.0, height]), normal=terrain.get("normal", UP))
    except (TypeError, ValueError):
        raise SolutionFileError("terrain in meta has no numeric 'height' and 'normal'") from None
    except InputError:
        raise SolutionFileError("terrain in meta has no finite 'height' and 'normal' (3,)") from None


def scene_of_meta(model: pin.Model, described: Any) -> CollisionScene | None:
    """Read ``meta["collision"]``; None where there is none. Raises `SolutionFileError`."""
    if described is None:
        return None
    try:
        return _scene(model, described)
    except InputError as error:
        raise SolutionFileError(f"collision of meta: {error.what}", error.allowed) from None


def bodies_of(described: Any) -> RobotShapes | None:
    """Read ``meta["bodies"]``, the shapes of the robot's links; None where there are none.

    Raises `SolutionFileError`.
    """
    if described is None:
        return None
    try:
        return RobotShapes.from_description(described)
    except InputError as error:
        raise SolutionFileError(f"bodies of meta: {error.what}", error.allowed) from None


def body_scene_of(model: pin.Model, meta: Mapping[str, Any]) -> CollisionScene | None:
    """Scene of the links' shapes, the obstacles and the terrain of a solution; None without shapes.

    Raises `SolutionFileError`.
    """
    bodies, given = bodies_of(meta.get("bodies")), scene_of_meta(model, meta.get("collision"))
    if bodies is None or not bodies.shapes:
        return None
    try:
        terrain = terrain_from_description(meta["terrain"]) if meta.get("terrain") else None
        return bodies.scene(model, terrain, () if given is None else given.obstacles)
    except InputError as error:
        raise SolutionFileError(f"bodies of meta: {error.what}", error.allowed) from None


def body_margins_of(meta: Mapping[str, Any], scene: CollisionScene) -> np.ndarray:
    """Least distance (n_pairs,) m that a problem asked of each pair of `body_scene_of`; zero: no contact.

    Raises `SolutionFileError`.
    """
    found = np.zeros(len(scene.pairs))
    given = meta["bodies"].get("margins")
    if given is None:
        return found
    try:
        found[scene.n_ground : scene.n_outer] = float(given["obstacles"])
        found[scene.n_outer :] = np.array(given["pairs"], dtype=float).reshape(len(scene.self_pairs))
    except (KeyError, TypeError, ValueError):
        found[:] = np.nan
    if not (found >= 0).all() or not np.isfinite(found).all():
        raise SolutionFileError(
            "margins of bodies of meta are not those of its pairs",
            "allowed: {obstacles: m, pairs: [m, ...]}, not negative, one for each of pairs",
        )
    return found


def _scene(model: pin.Model, described: Any) -> CollisionScene:
    keys = ("capsules", "obstacles", "self_pairs")
    if not isinstance(described, dict) or not all(isinstance(described.get(key), list) for key in keys):
        raise InputError("it is not an object of lists", f"keys: {', '.join(keys)}")
    pairs = described["self_pairs"]
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise InputError("self_pairs are not pairs", "allowed: [capsule, capsule] by name")
    return CollisionScene(
        model=model,
        shapes=tuple(LinkShape.from_description(entry) for entry in described["capsules"]),
        obstacles=tuple(obstacle_from_description(entry) for entry in described["obstacles"]),
        self_pairs=tuple((str(first), str(second)) for first, second in pairs),
    )


def jsonable(value: Any) -> Any:
    """The value with lists for tuples and arrays, and None for numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [jsonable(entry) for entry in list(value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value
