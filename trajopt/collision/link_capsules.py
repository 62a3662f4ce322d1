"""Capsules of any robot: one around each piece of its collision or visual geometry, or of its inertias.

The capsule around points has the least volume found over the direction of its axis. For a given direction
the least one is exact: its radius and place follow from the least circle around the points seen along the
axis, its ends from how far each point reaches beyond the cap. The direction is searched by Nelder and Mead's
method from the three principal axes. No step is random.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import coal
import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.collision.hulls import joint_frame, prism_corners
from trajopt.collision.shapes import LinkShape, box_corners, require_different_names
from trajopt.errors import InputError, shown
from trajopt.robot.robot import Robot
from trajopt.terrain.bodies import convex_hull
from trajopt.terrain.surface import frame_of_normal

Source = Literal["collision", "visual", "inertia"]
# A link of several pieces gets one capsule if that has at most this many times the pieces' volume: fingers
# and housings do, a bent link does not.
MERGED = 2.0
SOURCES: tuple[Source, ...] = ("collision", "visual", "inertia")
# Points count as inside within this part of the radius: rounding of a circle through three points.
INSIDE = 1e-12
# The least circle settles in a few exchanges of its support; a cycle through rounding ends here.
MOST_EXCHANGES = 100
# Tolerance of the search for a direction, rad: at a minimum it changes the volume by parts in 1e4.
DIRECTION_ERROR = 1e-2
MOST_DIRECTIONS = 80
# First step of the search from a principal axis, rad.
FIRST_STEP = 0.15
# A circle's polygon, tangent to it from outside, is 0.5 % larger with this many corners.
ROUND_CORNERS = 32
# Points this close to a plane or a line, as a fraction of their extent, have no hull with a volume.
FLAT = 1e-9


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
        raise InputError(f"capsules from {shown(source)}", f"allowed: {', '.join(SOURCES)}")
    tried = (source,) if source is not None else SOURCES
    geometry = next((pieces for pieces in (_pieces(robot, name) for name in tried) if pieces), None)
    if not geometry:
        raise InputError(
            f"robot '{robot.name}' has no {' or '.join(tried)} geometry on its moving links",
            "allowed: another source, or capsules given by hand",
        )
    given = dict(override or {})
    links = {link for link, _, _ in geometry}
    unknown = sorted(set(given) - links)
    if unknown:
        raise InputError(f"capsules are given for {', '.join(unknown)}", f"links: {', '.join(sorted(links))}")
    capsules = []
    for link in dict.fromkeys(link for link, _, _ in geometry):
        by_hand = given.get(link)
        pieces = [(joint, spanned) for name, joint, spanned in geometry if name == link]
        capsules += list(by_hand) if by_hand is not None else _of_link(robot.model, link, pieces)
    require_different_names("capsules", [capsule.name for capsule in capsules])
    return tuple(capsules)


Spanned = tuple[np.ndarray, float]
Piece = tuple[str, int, Spanned]


def _of_link(model: pin.Model, link: str, pieces: list[tuple[int, Spanned]]) -> list[LinkShape]:
    """One capsule around each piece of a link, or around all where that adds little."""
    joint = pieces[0][0]
    fitted = [
        # A ball or a capsule is its own.
        Segment(points[0], points[-1], radius)
        if len(points) == 1 or (len(points) == 2 and radius > 0)
        else enclosing_capsule(points)
        for _, (points, radius) in pieces
    ]
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
        shape = entry.geometry
        if entry.parentJoint == 0 or (isinstance(shape, coal.BVHModelBase) and not shape.num_vertices):
            continue
        points, radius = spanning_points(shape)
        moved = points @ entry.placement.rotation.T + entry.placement.translation
        pieces.append((str(frame.name), int(entry.parentJoint), (moved, radius)))
    return pieces


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
        return prism_corners(float(geometry.radius), 2 * float(geometry.halfLength), ROUND_CORNERS), 0.0
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


@dataclass(frozen=True)
class Segment:
    """Axis of a capsule: ``start``, ``end`` (3,) and ``radius``, m."""

    start: np.ndarray
    end: np.ndarray
    radius: float

    @property
    def volume(self) -> float:
        """Volume of the capsule, m^3."""
        length = float(np.linalg.norm(self.end - self.start))
        return math.pi * self.radius**2 * (length + 4 / 3 * self.radius)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Distance (n,) in m of points (n, 3) from the capsule's surface, positive inside."""
        along = self.end - self.start
        square = float(along @ along)
        share = np.clip((points - self.start) @ along / square, 0, 1) if square > 0 else np.zeros(len(points))
        nearest = self.start + share[:, None] * along
        return np.asarray(self.radius - np.linalg.norm(points - nearest, axis=1))


def enclosing_capsule(points: np.ndarray) -> Segment:
    """Capsule of small volume that holds all points (n, 3), m; deterministic."""
    points = np.asarray(points, dtype=float)
    corners = _corners(points)
    _, axes = np.linalg.eigh(np.cov((corners - corners.mean(axis=0)).T) if len(corners) > 1 else np.eye(3))
    candidates = [_best_near(corners, axes[:, i]) for i in range(3)]
    best = min(candidates, key=lambda segment: segment.volume)
    outside = max(0.0, -float(best.depth(points).min()))
    return Segment(best.start, best.end, best.radius + outside)


def _corners(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull; all points where the hull has no volume."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 4 else np.zeros(1)
    if len(spread) < 3 or spread[2] <= FLAT * spread[0]:
        return points
    return convex_hull(points).corners


def _best_near(points: np.ndarray, axis: np.ndarray) -> Segment:
    """Least volume over directions near ``axis``, by Nelder and Mead's method over two tilts."""
    from scipy.optimize import minimize

    turn = frame_of_normal(axis)

    def capsule(tilts: np.ndarray) -> Segment:
        direction = turn @ np.array([tilts[0], tilts[1], 1.0])
        return along(points, direction / np.linalg.norm(direction))

    first = np.array([[0.0, 0.0], [FIRST_STEP, 0.0], [0.0, FIRST_STEP]])
    options = {
        "initial_simplex": first,
        "xatol": DIRECTION_ERROR,
        "fatol": np.inf,
        "maxfev": MOST_DIRECTIONS,
    }
    result = minimize(lambda tilts: capsule(tilts).volume, np.zeros(2), method="Nelder-Mead", options=options)
    return capsule(result.x)


def along(points: np.ndarray, direction: np.ndarray) -> Segment:
    """Capsule along the unit ``direction`` (3,) around points (n, 3): least radius, then least length."""
    turn = frame_of_normal(direction)
    local = points @ turn
    centre, radius = least_circle(local[:, :2])
    away = np.sum((local[:, :2] - centre) ** 2, axis=1)
    cap = np.sqrt(np.maximum(radius**2 - away, 0.0))
    low, high = float((local[:, 2] + cap).min()), float((local[:, 2] - cap).max())
    if low > high:
        low = high = (low + high) / 2
    start, end = (turn @ np.array([*centre, height]) for height in (low, high))
    return Segment(start, end, radius)


def least_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the least circle around points (n, 2).

    Support points are exchanged: the farthest point joins, and the least circle through two or three of
    them that holds all of them is kept. The radius grows at each exchange, so the search terminates.
    """
    support = points[[int(np.argmax(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))]]
    centre, radius = support[0], 0.0
    for _ in range(MOST_EXCHANGES):
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius * (1 + INSIDE):
            break
        support, centre, radius = _exchanged(np.vstack([support, points[farthest]]))
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _exchanged(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The least circle around at most four points, and those on it; the last point is always one."""
    last, others = points[-1], points[:-1]
    best: tuple[np.ndarray, np.ndarray, float] | None = None
    candidates = [np.array([other, last]) for other in others]
    candidates += [np.array([others[i], others[j], last]) for i in range(len(others)) for j in range(i)]
    for support in candidates:
        circle = _through(support)
        if circle is None or (best is not None and circle[1] >= best[2]):
            continue
        if np.linalg.norm(points - circle[0], axis=1).max() <= circle[1] * (1 + 10 * INSIDE) + 1e-300:
            best = (support, *circle)
    if best is None:  # three points in line up to rounding: the widest two
        widest = max(candidates[: len(others)], key=lambda pair: float(np.linalg.norm(pair[1] - pair[0])))
        return widest, widest.mean(axis=0), float(np.linalg.norm(widest[1] - widest[0])) / 2
    return best


def _through(points: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Circle on two points as a diameter, or through three; None where they lie in line."""
    if len(points) == 2:
        return points.mean(axis=0), float(np.linalg.norm(points[1] - points[0])) / 2
    edges = points[1:] - points[0]
    determinant = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    if abs(determinant) <= FLAT * np.abs(edges).max() ** 2:
        return None
    offset = np.linalg.solve(2 * edges, np.sum(edges**2, axis=1))
    return points[0] + offset, float(np.linalg.norm(offset))
