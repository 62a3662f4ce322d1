"""Simple shapes of a robot's links from its description: convex hulls of meshes, prisms of cylinders."""

import hashlib
import importlib.metadata
import math
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.cache import read_entry, write_entry
from trajopt.collision.coal_shapes import coal_hull, thicken
from trajopt.collision.shapes import LinkShape, box_corners
from trajopt.errors import InputError
from trajopt.robot.data import VisualSource
from trajopt.robot.geometry import Purpose, described_geometry, mesh_vertices

# Allowed excess of a simplified hull over the mesh's hull: over the mesh's extent, and its bounds in m.
EXCESS = 0.005
LEAST_EXCESS, MOST_EXCESS = 5e-4, 2e-3
# Hulls with fewer than FEW_CORNERS corners are refined to this excess, m.
FEW_CORNERS, FINE_EXCESS = 48, 1e-4
# Corners outside by more than this fraction of the farthest are added together, one per face.
FAR_SHARE = 0.9
# Allowed excess of a prism over its cylinder: a fraction of the radius, or in m if that is larger.
ROUND_EXCESS, LEAST_ROUND_EXCESS = 0.01, 3e-4
# Accuracy of Coal's distance of a point from a hull, m; points of shapes are rounded to it.
ROUNDING = 1e-6
# Directions of the first corners: along the axes and the diagonals.
DIRECTIONS = np.array(
    [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)]
)
PURPOSES: tuple[Purpose, ...] = ("collision", "visual")
# Coordinates of shapes are rounded to this many decimals of a metre, to keep files small.
DECIMALS = 6
# Number of meshes whose simplified hulls are cached.
MOST_HULLS = 256

# A body in the axes of its geometry: points (n, 3) and radius, m.
_Body = tuple[np.ndarray, float]


def simplified(points: np.ndarray, fine: bool = False) -> tuple[np.ndarray, float]:
    """Return few corners (k, 3) m and a radius whose swept hull contains the hull of ``points`` (n, 3) m.

    Every corner of the full hull is within the radius of the hull of the corners kept, so by convexity all of
    it is. The farthest corners are added until all are within the allowed excess: `EXCESS` of the mesh's
    extent, or `LEAST_EXCESS` if ``fine``. The mesh of a ball becomes one point. The result is deterministic
    and cached by the points.
    """
    given = np.ascontiguousarray(points, dtype=float)
    name = f"hull.{hashlib.sha256(f'{_maker()}|{fine}|'.encode() + given.tobytes()).hexdigest()[:32]}"
    entry = read_entry(name)
    if entry is not None:
        numbers = np.frombuffer(entry)
        return numbers[1:].reshape(-1, 3).copy(), float(numbers[0])
    corners, radius = _simplified(given, fine)
    write_entry(name, np.append(radius, corners).tobytes())
    return corners, radius


@lru_cache(maxsize=1)
def _maker() -> str:
    """Return what an entry depends on besides the points: versions, and this code."""
    versions = [importlib.metadata.version(name) for name in ("scipy", "coal")]
    return "|".join([*versions, Path(__file__).read_text("utf-8")])


def _simplified(points: np.ndarray, fine: bool) -> tuple[np.ndarray, float]:
    from scipy.spatial import ConvexHull  # slow to import

    solid = thicken(points)
    whole = ConvexHull(solid)
    corners = solid[np.sort(whole.vertices)]
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    allowed = LEAST_EXCESS if fine else min(max(EXCESS * extent, LEAST_EXCESS), MOST_EXCESS)
    allowed -= 3 * ROUNDING
    ball = _ball(corners, whole.equations)
    if ball[1] - ball[2] <= allowed:
        return np.round(ball[0], 6)[None], round(ball[1] + 2 * ROUNDING, 6)
    kept = list(dict.fromkeys((corners @ DIRECTIONS.T).argmax(axis=0).tolist()))
    if len(corners) <= len(kept):
        return np.round(corners, 6), 2 * ROUNDING
    hull = ConvexHull(corners[kept], incremental=True)
    while True:
        enough = allowed if len(kept) >= FEW_CORNERS else FINE_EXCESS
        over = corners @ hull.equations[:, :3].T + hull.equations[:, 3]
        outside, face = over.max(axis=1), over.argmax(axis=1)
        if outside.max() <= enough:
            outside = _distances(corners, corners[kept])
            if outside.max() <= enough:
                break
        order = np.argsort(-outside, kind="stable")
        order = order[outside[order] >= FAR_SHARE * outside[order[0]]]
        new = order[np.sort(np.unique(face[order], return_index=True)[1])]
        kept += new.tolist()
        hull.add_points(corners[new])
    kept = [kept[index] for index in sorted(set(hull.simplices.ravel().tolist()))]
    radius = max(float(outside.max()), 0.0) + 2 * ROUNDING
    return np.round(corners[kept], 6), round(math.ceil(radius / ROUNDING) * ROUNDING, 6)


def _ball(corners: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Fit a ball to corners (n, 3); return its centre (3,), and outer and inner radius of their hull, m."""
    rows = np.column_stack([2 * corners, np.ones(len(corners))])
    centre = np.linalg.lstsq(rows, np.sum(corners**2, axis=1), rcond=None)[0][:3]
    outer = float(np.linalg.norm(corners - centre, axis=1).max())
    return centre, outer, float(-(planes[:, :3] @ centre + planes[:, 3]).max())


def _distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return distances (n,) m of points (n, 3) from the hull of ``corners`` (k, 3), zero inside."""
    hull, ball = coal_hull(corners), coal.Sphere(ROUNDING)
    measure = coal.ComputeDistance(hull, ball)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    still, place, distances = coal.Transform3s(), coal.Transform3s(), np.empty(len(points))
    for index, point in enumerate(points):
        place.setTranslation(point)
        result.clear()
        distances[index] = measure(still, place, request, result) + ROUNDING
    return np.maximum(distances, 0.0)


def prism(radius: float, height: float) -> np.ndarray:
    """Return corners (2 k, 3) m of a prism around a cylinder about z, with faces tangent to the cylinder."""
    excess = max(ROUND_EXCESS, LEAST_ROUND_EXCESS / radius)
    return prism_corners(radius, height, max(math.ceil(math.pi / math.acos(1 / (1 + excess))), 6))


def prism_corners(radius: float, height: float, count: int) -> np.ndarray:
    """Return corners (2 count, 3) m of a prism around a cylinder about z."""
    angle = 2 * np.pi * np.arange(count) / count
    ring = radius / math.cos(math.pi / count) * np.column_stack([np.cos(angle), np.sin(angle)])
    half = np.full(count, height / 2)
    return np.concatenate([np.column_stack([ring, -half]), np.column_stack([ring, half])])


def read_shapes(
    source: VisualSource, model: pin.Model
) -> tuple[tuple[LinkShape, ...], dict[str, str], tuple[str, ...]]:
    """Return the shapes of all links, also fixed ones, the link of each shape, and what could not be read.

    Spheres, capsules and boxes are kept; a cylinder becomes a `prism` around it, a mesh its `simplified`
    convex hull, which is finer for the last links, since feet and hands touch. Each shape is on the frame of
    the joint that moves it, and has the name of its link, with a number if the link has several shapes.
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
    """Yield link, joint and body (in the joint's frame) of every element; append errors to ``missing``."""
    described = described_geometry(source, model, purpose)
    missing += [f"{name}: no file {file}" for name, file in described.missing.items()]
    carrying = set(model.parents)
    for entry in described.geometry.geometryObjects:
        try:
            if entry.name in described.meshes:
                path, fine = str(entry.meshPath), entry.parentJoint not in carrying
                changed, scale = Path(path).stat().st_mtime_ns, tuple(np.ravel(entry.meshScale))
                points, radius = _simplified_once(path, changed, scale, fine)
            else:
                points, radius = _body_of(entry.geometry)
        except InputError as error:
            missing.append(f"{entry.name}: {error.what}")
            continue
        placed = points @ entry.placement.rotation.T + entry.placement.translation
        link = str(model.frames[entry.parentFrame].name)
        yield link, int(entry.parentJoint), (placed, radius)


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
    """Return the name of a frame that moves with a joint and has a unique name. Raises InputError.

    The joint's own frame is preferred.
    """
    counts = Counter(str(frame.name) for frame in model.frames)
    names = [str(frame.name) for frame in model.frames if frame.parentJoint == joint]
    known = sorted((name for name in names if counts[name] == 1), key=lambda name: name != model.names[joint])
    if not known:
        raise InputError(f"joint '{model.names[joint]}' has no frame with a name of its own", "allowed: one")
    return known[0]
