"""Compact meshes for a page: a form that compresses well, as exact as a picture can show.

Vertices are welded and counted in the order in which triangles use them. An index is then how far back the
vertex was seen ("high water mark", as in WebGL-Loader, Chun 2012): mostly small numbers, 0 for a new vertex.
Positions are whole numbers over the mesh's extent, each as the difference from the one before; normals are
folded onto an octahedron (Cigolle et al. 2014, "A survey of efficient representations for independent unit
vectors"). High and low bytes lie apart. The page's web/meshes.js undoes all this.

A position is wrong by at most half of 1 / `LEVELS` of the mesh's extent along each axis, a normal by about a
degree. Files without vertex normals (STL) get them in the page: smooth except at creases.
"""

from typing import Any

import numpy as np

from trajopt.robot.geometry import STL_HEADER, stl_corners

# Steps of a position over the extent along an axis: 1 m in steps of 0.06 mm.
LEVELS = 2**14 - 1
# Steps of each of the two coordinates of a normal.
NORMAL_LEVELS = 254
# Smaller meshes stay unchanged: there is nothing to gain.
LEAST_CORNERS = 300
# Rows of whole numbers are compared as one number, up to this value.
LARGEST_KEY = 2**62
# Bytes per difference in each column.
PLANES = {"position": 2, "normal": 2, "colour": 4}
# A file whose normals multiply vertices by more than this draws every face flat: the page makes better ones.
FACETED = 1.5
STL_FORMATS = ("_meshfile", "_meshfile_geometry")


# Vertices: position (n, 3) m, optionally normal (n, 3) and color (n, 3) bytes; index (3m,) of corners.
TriangleMesh = tuple[dict[str, np.ndarray], np.ndarray]


def compact_geometry(geometry: dict[str, Any]) -> dict[str, Any] | None:
    """Return the content of a three.js geometry in few bytes; None if it is small or not a triangle mesh."""
    mesh = _triangles(geometry)
    return _packed(*mesh) if mesh is not None and len(mesh[1]) >= LEAST_CORNERS else None


def _triangles(geometry: dict[str, Any]) -> TriangleMesh | None:
    data: Any = geometry.get("data")
    if geometry.get("type") in STL_FORMATS and geometry.get("format") == "stl":
        return _stl_triangles(bytes(getattr(data, "data", data)))
    if not isinstance(data, dict) or "index" not in data:
        return None
    attributes = {name: _array(entry) for name, entry in data["attributes"].items()}
    if not set(attributes) <= {"position", "normal", "color"} or attributes["position"].shape[1:] != (3,):
        return None
    if "color" in attributes and attributes["color"].dtype != np.uint8:
        return None
    return attributes, _array(data["index"]).astype(np.int64)


def _array(entry: dict[str, Any]) -> np.ndarray:
    """An attribute (n, itemSize) or an index (n,) of a geometry, from Meshcat's packed array."""
    kinds = {"Float32Array": np.float32, "Uint32Array": np.uint32, "Uint8Array": np.uint8}
    values = np.frombuffer(entry["array"].data, dtype=kinds[entry["type"]])
    return values.reshape(-1, entry["itemSize"]) if kinds[entry["type"]] is not np.uint32 else values


def _stl_triangles(data: bytes) -> TriangleMesh | None:
    corners = stl_corners(data)
    if corners is None or len(corners) != 3 * int(np.frombuffer(data, "<u4", 1, STL_HEADER - 4)[0]):
        return None  # text, or damaged: left to the viewer
    return {"position": corners}, np.arange(len(corners))


def _packed(vertex: dict[str, np.ndarray], index: np.ndarray) -> dict[str, Any] | None:
    position = vertex["position"]
    if not np.isfinite(position).all():
        return None
    low = position.min(axis=0).astype(float)
    step = (position.max(axis=0) - low) / LEVELS
    columns = {"position": np.rint((position - low) / np.where(step > 0, step, 1.0)).astype(np.int64)}
    packed: dict[str, Any] = {"low": low.tolist(), "step": step.tolist()}
    if "color" in vertex:
        palette, columns["colour"] = _palette(vertex["color"])
        packed["palette"] = palette.tobytes()
    corners, vertices = _welded(columns, index)
    if "normal" in vertex:
        with_normals = _welded({**columns, "normal": octahedral_coordinates(vertex["normal"])}, index)
        if len(with_normals[1]["position"]) <= FACETED * len(vertices["position"]):
            corners, vertices = with_normals
    if len(corners) == 0:
        return None
    packed |= {"vertices": len(vertices["position"]), "corners": len(corners)}
    packed["index"] = _planes(_backward(corners), 4)
    return packed | {name: _planes(_differences(rows), PLANES[name]) for name, rows in vertices.items()}


def _palette(colour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct colours (k, 3), and the index of each vertex's colour among them (n, 1)."""
    keys = colour.astype(np.int64) @ np.array([2**16, 2**8, 1])
    distinct, number = np.unique(keys, return_inverse=True)
    return np.column_stack([distinct >> 16, distinct >> 8, distinct]).astype(np.uint8), number[:, None]


def _welded(columns: dict[str, np.ndarray], index: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The vertex of every corner, and the columns of distinct vertices in the order of their first use.

    ``columns`` are non-negative integers (n, k). Triangles that have shrunk to a line are left out.
    """
    first, number = _distinct(np.column_stack(list(columns.values())))
    triangles = number[index].reshape(-1, 3)
    a, b, c = triangles.T
    corners = triangles[(a != b) & (b != c) & (a != c)].ravel()
    place = np.full(len(first), len(corners))
    place[corners[::-1]] = np.arange(len(corners))[::-1]  # the last one written is the first use
    order = np.argsort(place, kind="stable")[: np.count_nonzero(place < len(corners))]
    rank = np.zeros(len(first), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank[corners], {name: rows[first[order]] for name, rows in columns.items()}


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index of each distinct row of integers (n, k), and every row's number among them (n,)."""
    key, span = np.zeros(len(rows), dtype=np.int64), 1
    for column in rows.T:
        width = int(column.max(initial=0)) + 1
        if span * width > LARGEST_KEY:
            key = np.unique(key, return_inverse=True)[1]
            span = len(rows)
        key, span = key * width + column, span * width
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    return first, number


def _backward(index: np.ndarray) -> np.ndarray:
    """Distance of each index from the lowest index not seen before it: 0 for a new vertex."""
    seen = np.maximum.accumulate(np.concatenate([[-1], index[:-1]])) + 1 if len(index) else index
    return seen - index


def _differences(rows: np.ndarray) -> np.ndarray:
    """Differences down each column of (n, k), column by column; negative ones are coded as odd numbers."""
    change = np.diff(rows, axis=0, prepend=0).T.ravel()
    return np.where(change < 0, -2 * change - 1, 2 * change)


def _planes(values: np.ndarray, count: int) -> bytes:
    """The lowest bytes of all ``values``, then the next ones, in ``count`` planes."""
    return np.ascontiguousarray(values.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :count].T).tobytes()


def octahedral_coordinates(normal: np.ndarray) -> np.ndarray:
    """Return unit vectors (n, 3) as points (n, 2) of an unfolded octahedron, from 0 to `NORMAL_LEVELS`."""
    length = np.abs(normal).sum(axis=1, keepdims=True)
    x, y, z = (normal / np.where(length > 0, length, 1.0)).T
    below = z < 0
    side_x, side_y = np.where(x >= 0, 1.0, -1.0), np.where(y >= 0, 1.0, -1.0)
    u = np.where(below, (1 - np.abs(y)) * side_x, x)
    v = np.where(below, (1 - np.abs(x)) * side_y, y)
    return np.rint((np.column_stack([u, v]) + 1) / 2 * NORMAL_LEVELS).astype(np.int64)
