"""Ground under a swing over piecewise terrain: its height, and the edges that must not be cut.

Along the straight line from lift-off to touchdown the ground is a polyline with jumps. If it is nowhere above
the planes of both ends (one plane, or a valley), a foot above these planes is above the ground. Otherwise
there is an obstacle: the foot rises to its top before it passes the edge where the obstacle begins, and
descends below the top after it has passed the edge where the obstacle ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import CRACK, PiecewiseTerrain
from trajopt.terrain.surface import SAME_PLANE, Surface

# Horizontal parts of an edge's normal shorter than this have no direction.
NO_DIRECTION = 1e-9
# Distance kept from an edge beyond the radius, in clearances, and its largest share of the room there.
EDGE_ROOM, ROOM_SHARE = 0.5, 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Edge:
    """A vertical plane through an edge: positions p (3,) with ``normal @ p >= offset`` are on the free side.

    ``normal`` (3,) is horizontal and of unit length. ``part`` is the fraction of the way, from the free end,
    at which the line meets the edge.
    """

    normal: np.ndarray
    offset: float
    part: float

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Distance (...) in m of positions (..., 3) from the edge, positive on the free side."""
        return np.asarray(np.asarray(position) @ self.normal - self.offset)

    def kept_from(self, points: np.ndarray, clearance: float, radius: float) -> Edge:
        """The edge moved by a distance to keep from it, within that of a foot at ``points`` (n, 3) m."""
        room = max(float(self.distance(points).min()), 0.0)
        keep = min(radius, room) + min(EDGE_ROOM * clearance, ROOM_SHARE * max(room - radius, 0.0))
        return replace(self, offset=self.offset + keep)

    def met_earlier(self, part: float) -> Edge:
        """The same edge, met earlier by the fraction ``part`` of the way, but not before the free end."""
        return replace(self, part=max(self.part - part, 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossing:
    """Ground between two positions of a foot: planes at both ends, and the top of the obstacle between.

    ``top``, m, is None without an obstacle. ``rise`` is the edge before which the foot rises to the top, None
    if it starts there; ``fall`` is the edge behind which it descends, None if it ends there.
    """

    first: Surface
    last: Surface
    top: float | None = None
    rise: Edge | None = None
    fall: Edge | None = None

    def offset(self, distance: float, start: np.ndarray, end: np.ndarray) -> Crossing:
        """The same ground for the centre of a ball of radius ``distance`` m that moves from start to end.

        Planes and top are raised, edges are met earlier, and the centre stays ``distance`` m from them.
        """
        if not distance:
            return self
        first, last = self.first.offset(distance), self.last.offset(distance)
        top = self.top
        if top is not None:
            ends = [_level(plane, point) for plane, point in ((first, start), (last, end)) if plane.normal[2]]
            top = max(top + distance, *ends)
        way = float(np.hypot(*(end - start)[:2]))
        rise, fall = (
            edge and replace(edge, offset=edge.offset + distance).met_earlier(distance / way)
            for edge in (self.rise, self.fall)
        )
        return Crossing(first=first, last=last, top=top, rise=rise, fall=fall)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Piece:
    """The ground from a fraction ``begin`` to ``end`` of the way; ``face`` is None in a hole."""

    begin: float
    end: float
    face: Patch | None


def crossing(
    terrain: PiecewiseTerrain, start: np.ndarray, end: np.ndarray, first: Surface, last: Surface
) -> Crossing:
    """The ground between ``start`` and ``end`` (3,) m, which are on the planes ``first`` and ``last``."""
    pieces = [piece for piece in _pieces(terrain, start, end) if piece.face is not None]
    ends = [(_level(first, start), _level(first, end)), (_level(last, start), _level(last, end))]
    heights = [
        (_height(piece, piece.begin, start, end), _height(piece, piece.end, start, end)) for piece in pieces
    ]

    def over(which: int, part: float, height: float) -> float:
        low, high = ends[which]
        return height - (1 - part) * low - part * high

    above = [
        [max(over(i, p.begin, h[0]), over(i, p.end, h[1])) for i in (0, 1)]
        for p, h in zip(pieces, heights, strict=True)
    ]
    heights_at_ends = ends[0][0], ends[1][1]
    valley = ends[1][0] <= heights_at_ends[0] + SAME_PLANE and ends[0][1] <= heights_at_ends[1] + SAME_PLANE
    if valley and all(min(both) <= SAME_PLANE for both in above):
        return Crossing(first=first, last=last)
    top = max([*heights_at_ends, *(max(pair) for pair in heights)])
    rise = fall = None
    if heights_at_ends[0] < top - SAME_PLANE:
        rise = _edge(_place(pieces, heights, [both[0] for both in above], top), pieces, start, end)
    if heights_at_ends[1] < top - SAME_PLANE:
        back = [replace(piece, begin=1 - piece.end, end=1 - piece.begin) for piece in reversed(pieces)]
        turned = [(pair[1], pair[0]) for pair in reversed(heights)]
        fall = _edge(_place(back, turned, [both[1] for both in reversed(above)], top), back, end, start)
    return Crossing(first=first, last=last, top=top, rise=rise, fall=fall)


def _level(plane: Surface, point: np.ndarray) -> float:
    """Height of a plane under a position."""
    normal = plane.normal
    return float((plane.height - normal[0] * point[0] - normal[1] * point[1]) / normal[2])


def _height(piece: _Piece, part: float, start: np.ndarray, end: np.ndarray) -> float:
    assert piece.face is not None  # pieces without ground were left out
    return _level(piece.face.surface, start + part * (end - start))


def _pieces(terrain: PiecewiseTerrain, start: np.ndarray, end: np.ndarray) -> list[_Piece]:
    """The highest faces along the way, in order."""
    stops = {0.0, 1.0}  # where the way, seen from above, meets the lines of faces' edges
    for face in terrain.faces:
        edges = [_edge_plane(face, index) for index in range(len(face.vertices))]
        outside = [[float(normal @ point - offset) for point in (start, end)] for normal, offset in edges]
        parts = [a / (a - b) for a, b in outside if abs(a - b) > NO_DIRECTION]
        stops |= {part for part in parts if 0 < part < 1}
    pieces: list[_Piece] = []
    for a, b in pairwise(sorted(stops)):
        if b - a > CRACK:
            middle = start + (a + b) / 2 * (end - start)
            highest = terrain.face_at(float(middle[0]), float(middle[1]))
            if pieces and pieces[-1].face is highest:
                a = pieces.pop().begin
            pieces.append(_Piece(begin=a, end=b, face=highest))
    return pieces


def _edge_plane(face: Patch, index: int) -> tuple[np.ndarray, float]:
    """Horizontal unit normal (3,) out of a face at an edge, and its offset."""
    a, b = face.vertices[index], face.vertices[(index + 1) % len(face.vertices)]
    out = np.array([b[1] - a[1], a[0] - b[0], 0.0])
    out /= np.linalg.norm(out)
    return out, float(out @ a)


def _place(pieces: list[_Piece], heights: list[tuple[float, float]], above: list[float], top: float) -> float:
    """Fraction of the way where the ground first rises above the start's plane, or else reaches the top."""
    for piece, over in zip(pieces, above, strict=True):
        if over > SAME_PLANE:
            return piece.begin
    for piece, pair in zip(pieces, heights, strict=True):
        for part, height in zip((piece.begin, piece.end), pair, strict=True):
            if height >= top - SAME_PLANE:
                return part
    return 1.0


def _edge(part: float, pieces: list[_Piece], start: np.ndarray, end: np.ndarray) -> Edge | None:
    """The edge met at the fraction ``part``, free on the start's side; None if the start is beyond it."""
    if part <= CRACK:
        return None
    point, way = start + part * (end - start), (end - start) * [1, 1, 0]
    length = float(np.linalg.norm(way))
    if length <= NO_DIRECTION:
        return None
    normal = -way / length
    entered = [piece.face for piece in pieces if abs(piece.begin - part) <= CRACK and piece.face is not None]
    for face in entered:
        for index in range(len(face.vertices)):
            out, offset = _edge_plane(face, index)
            if abs(out @ point - offset) <= SAME_PLANE and out @ way < 0:
                normal = out
    return Edge(normal=normal, offset=float(normal @ point), part=part)
