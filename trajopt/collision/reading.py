"""Shapes of the links of a robot's description: its collision elements, or hulls of what is drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.collision.hulls import prism, simplified
from trajopt.collision.shapes import LinkShape, box_corners
from trajopt.errors import InputError
from trajopt.robot.data import VisualSource
from trajopt.robot.geometry import Purpose, described_geometry, mesh_vertices

PURPOSES: tuple[Purpose, ...] = ("collision", "visual")
# Shapes' numbers are rounded to this many decimals of a metre: files stay small.
DECIMALS = 6
# Meshes whose simplified hulls are kept.
MOST_HULLS = 256

# A body in the axes of its geometry: points (n, 3) and radius, m.
_Body = tuple[np.ndarray, float]


def read_shapes(
    source: VisualSource, model: pin.Model
) -> tuple[tuple[LinkShape, ...], dict[str, str], tuple[str, ...]]:
    """Shapes of all links, also of those fixed to the world; the link of each shape; what could not be read.

    Spheres, capsules and boxes are themselves; a cylinder is a `prism` around it, a mesh its `simplified`
    convex hull, a finer one behind the last joints, since feet and hands touch. Each shape is on the frame
    of the joint that moves it, and has the name of its link, with a number where the link has several.
    """
    missing: list[str] = []
    for purpose in PURPOSES:
        try:
            bodies = list(_bodies(source, model, purpose, missing))
        except InputError as error:
            missing.append(str(error))
            continue
        if bodies:
            shapes, links = _named(model, bodies, missing)
            return shapes, links, tuple(dict.fromkeys(missing))
    return (), {}, tuple(dict.fromkeys(missing))


def _bodies(
    source: VisualSource, model: pin.Model, purpose: Purpose, missing: list[str]
) -> Iterator[tuple[str, int, _Body]]:
    """Link, joint and body, in the joint's axes, of every element; adds to ``missing``."""
    found = described_geometry(source, model, purpose)
    missing += [f"{name}: no file {file}" for name, file in found.missing.items()]
    carrying = set(model.parents)
    for entry in found.geometry.geometryObjects:
        try:
            points, radius = (
                _hull_of(entry, fine=entry.parentJoint not in carrying)
                if entry.name in found.meshes
                else _body_of(entry.geometry)
            )
        except InputError as error:
            missing.append(f"{entry.name}: {error.what}")
            continue
        placed = points @ entry.placement.rotation.T + entry.placement.translation
        link = str(model.frames[entry.parentFrame].name)
        yield link, int(entry.parentJoint), (placed, radius)


def _hull_of(entry: pin.GeometryObject, fine: bool) -> _Body:
    path = str(entry.meshPath)
    return _simplified_once(path, Path(path).stat().st_mtime_ns, tuple(np.ravel(entry.meshScale)), fine)


@lru_cache(maxsize=MOST_HULLS)
def _simplified_once(path: str, _changed: int, scale: tuple[float, ...], fine: bool) -> _Body:
    return simplified(mesh_vertices(path, scale), fine)


def _body_of(geometry: Any) -> _Body:
    if isinstance(geometry, coal.Sphere):
        return np.zeros((1, 3)), float(geometry.radius)
    if isinstance(geometry, coal.Capsule):
        end = np.array([0.0, 0.0, geometry.halfLength])
        return np.array([-end, end]), float(geometry.radius)
    if isinstance(geometry, coal.Box):
        return box_corners(-geometry.halfSide, geometry.halfSide), 0.0
    if isinstance(geometry, coal.Cylinder):
        return prism(float(geometry.radius), 2 * float(geometry.halfLength)), 0.0
    if isinstance(geometry, coal.BVHModelBase) and geometry.num_vertices:
        return simplified(np.array(geometry.vertices()))
    if isinstance(geometry, coal.ConvexBase):
        return simplified(np.array(geometry.points()))
    raise InputError(f"a shape of kind {type(geometry).__name__} is not known")


def _named(
    model: pin.Model, bodies: list[tuple[str, int, _Body]], missing: list[str]
) -> tuple[tuple[LinkShape, ...], dict[str, str]]:
    counts, seen = Counter(link for link, _, _ in bodies), Counter[str]()
    shapes, links = [], {}
    for link, joint, (points, radius) in bodies:
        name = link if counts[link] == 1 and link != "ground" else f"{link}_{seen[link]}"
        seen[link] += 1
        try:
            frame = joint_frame(model, joint)
        except InputError as error:
            missing.append(f"{name}: {error.what}")
            continue
        within = model.frames[model.getFrameId(frame)].placement.inverse()
        placed = np.round(points @ within.rotation.T + within.translation, DECIMALS)
        shapes.append(LinkShape(name=name, frame=frame, points=placed, radius=radius))
        links[name] = link
    return tuple(shapes), links


def joint_frame(model: pin.Model, joint: int) -> str:
    """Name of a frame that moves with a joint and shares its name with no other frame. Raises InputError.

    The joint's own, if it can be.
    """
    counts = Counter(str(frame.name) for frame in model.frames)
    own = [str(frame.name) for frame in model.frames if frame.parentJoint == joint]
    known = sorted((name for name in own if counts[name] == 1), key=lambda name: name != model.names[joint])
    if not known:
        raise InputError(f"joint '{model.names[joint]}' has no frame with a name of its own", "allowed: one")
    return known[0]
