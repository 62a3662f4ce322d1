"""Capsules of any robot: one around each piece of its collision or visual geometry, or of its inertias."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import coal
import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.collision.fitting import Segment, enclosing_capsule, round_corners
from trajopt.collision.reading import joint_frame
from trajopt.collision.shapes import LinkShape, box_corners, require_different_names
from trajopt.errors import InputError
from trajopt.robot.robot import Robot

Source = Literal["collision", "visual", "inertia"]
# A link of several pieces gets one capsule if that has at most this many times the pieces' volume: fingers
# and housings do, a bent link does not.
MERGED = 2.0
SOURCES: tuple[Source, ...] = ("collision", "visual", "inertia")


@checked
def robot_capsules(
    robot: Robot,
    *,
    source: Source | None = None,
    override: Mapping[str, Sequence[LinkShape]] | None = None,
) -> tuple[LinkShape, ...]:
    """Capsules that enclose the moving links of ``robot``.

    source: "collision" or "visual" geometry of its description, a capsule around each link, or around each of
        its meshes and shapes where one around all is much larger; or
        "inertia", around the solid boxes that have the links' masses and inertias: an estimate, for models
        without geometry (a hollow link's box is larger than the link). Default: the first of them that the
        robot has.
    override: by link (of "inertia": joint), capsules instead of the fitted ones; an empty
        sequence leaves the link out.

    Links fixed to the world are left out: no motion moves them. Raises InputError.
    """
    if source is not None and source not in SOURCES:
        raise InputError(f"capsules from {source!r}", f"allowed: {', '.join(SOURCES)}")
    tried = (source,) if source is not None else SOURCES
    found = next((pieces for pieces in (_pieces(robot, name) for name in tried) if pieces), None)
    if not found:
        raise InputError(
            f"robot '{robot.name}' has no {' or '.join(tried)} geometry on its moving links",
            "allowed: another source, or capsules given by hand",
        )
    given = dict(override or {})
    links = {link for link, _, _ in found}
    unknown = sorted(set(given) - links)
    if unknown:
        raise InputError(f"capsules are given for {', '.join(unknown)}", f"links: {', '.join(sorted(links))}")
    capsules = []
    for link in dict.fromkeys(link for link, _, _ in found):
        own = given.get(link)
        pieces = [(joint, spanned) for name, joint, spanned in found if name == link]
        capsules += list(own) if own is not None else _of_link(robot.model, link, pieces)
    require_different_names("capsules", [capsule.name for capsule in capsules])
    return tuple(capsules)


Spanned = tuple[np.ndarray, float]
Piece = tuple[str, int, Spanned]


def _of_link(model: pin.Model, link: str, pieces: list[tuple[int, Spanned]]) -> list[LinkShape]:
    """One capsule around each piece of a link, or around all where that adds little."""
    joint = pieces[0][0]
    fitted = [_fitted(spanned) for _, spanned in pieces]
    if len(pieces) > 1 and all(radius == 0 for _, (_, radius) in pieces):
        whole = enclosing_capsule(np.concatenate([points for _, (points, _) in pieces]))
        if whole.volume <= MERGED * sum(segment.volume for segment in fitted):
            fitted = [whole]
    frame = joint_frame(model, joint)
    within = model.frames[model.getFrameId(frame)].placement
    names = [link] if len(fitted) == 1 else [f"{link}_{i}" for i in range(len(fitted))]
    return [
        LinkShape.capsule(
            name, frame, within.actInv(segment.start), within.actInv(segment.end), segment.radius
        )
        for name, segment in zip(names, fitted, strict=True)
    ]


def _fitted(spanned: Spanned) -> Segment:
    points, radius = spanned
    if len(points) == 1:
        return Segment(points[0], points[0], radius)
    if len(points) == 2 and radius > 0:
        return Segment(points[0], points[1], radius)
    return enclosing_capsule(points)


def _pieces(robot: Robot, source: Source) -> list[Piece]:
    """(link, its joint, (points (n, 3) m in the joint's axes, radius of a ball about each))."""
    if source == "inertia":
        return _inertia_boxes(robot.model)
    if robot.visual is None:
        return []
    kind = pin.GeometryType.COLLISION if source == "collision" else pin.GeometryType.VISUAL
    pieces = []
    for entry in robot.visual.geometry(robot.model, kind).geometryObjects:
        frame = robot.model.frames[entry.parentFrame]
        if entry.parentJoint == 0 or not _solid(entry.geometry):
            continue
        points, radius = spanning_points(entry.geometry)
        moved = points @ entry.placement.rotation.T + entry.placement.translation
        pieces.append((str(frame.name), int(entry.parentJoint), (moved, radius)))
    return pieces


def _solid(geometry: Any) -> bool:
    return not isinstance(geometry, coal.BVHModelBase) or geometry.num_vertices > 0


def spanning_points(geometry: Any) -> tuple[np.ndarray, float]:
    """Points (n, 3) in m and the radius of a ball about each, whose hull holds a Coal geometry."""
    if isinstance(geometry, coal.BVHModelBase):
        return np.asarray(geometry.vertices(), dtype=float), 0.0
    if isinstance(geometry, coal.ConvexBase):
        return np.asarray(geometry.points(), dtype=float), 0.0
    if isinstance(geometry, coal.Sphere):
        return np.zeros((1, 3)), float(geometry.radius)
    if isinstance(geometry, coal.Capsule):
        end = np.array([0.0, 0.0, geometry.halfLength])
        return np.array([-end, end]), float(geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        return round_corners(float(geometry.radius), 2 * float(geometry.halfLength)), 0.0
    geometry.computeLocalAABB()
    return box_corners(geometry.aabb_local.min_, geometry.aabb_local.max_), 0.0


def _inertia_boxes(model: pin.Model) -> list[Piece]:
    """Corners of the solid box of each moving link's mass and inertia: I_1 = m (b^2 + c^2) / 12 and so on."""
    pieces: list[Piece] = []
    for joint in range(1, model.njoints):
        inertia = model.inertias[joint]
        if not inertia.mass > 0:
            continue
        moments, axes = np.linalg.eigh(inertia.inertia)
        sides = np.sqrt(np.maximum(6 * (moments.sum() - 2 * moments) / inertia.mass, 0.0))
        if not sides.max() > 0:
            continue
        corners = box_corners(-sides / 2, sides / 2) @ axes.T + inertia.lever
        pieces.append((str(model.names[joint]), joint, (corners, 0.0)))
    return pieces


def inflated(capsules: Sequence[LinkShape], by: float) -> tuple[LinkShape, ...]:
    """The capsules with ``by`` m added to every radius, for a tool or cables that the meshes lack."""
    return tuple(replace(capsule, radius=capsule.radius + by) for capsule in capsules)
