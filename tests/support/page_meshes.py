"""Meshes of a page, undone by another way than the page's own, into what Meshcat would have been told."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree


def restored(mesh: Any) -> Any:
    """A mesh in few bytes as position, normal, color and index; anything else as it is."""
    if not (isinstance(mesh, dict) and "corners" in mesh):
        return mesh
    count = mesh["vertices"]
    levels = _columns(mesh["position"], 2, count)
    found = {"position": _entry(np.array(mesh["low"]) + levels * np.array(mesh["step"]), np.float32)}
    if "normal" in mesh:
        found["normal"] = _entry(_unfolded(_columns(mesh["normal"], 2, count)), np.float32)
    if "colour" in mesh:
        palette = np.frombuffer(mesh["palette"], np.uint8).reshape(-1, 3)
        found["color"] = _entry(palette[_columns(mesh["colour"], 4, count)[:, 0]], np.uint8)
    return {"attributes": found, "index": _entry(_index(mesh), np.uint32)}


def _entry(values: np.ndarray, kind: type) -> dict[str, Any]:
    return {"array": SimpleNamespace(data=values.astype(kind).tobytes())}


def array_of(mesh: dict[str, Any], name: str) -> np.ndarray:
    """Rows (n, 3) of an attribute of a mesh."""
    kind = np.uint8 if name == "color" else np.float32
    return np.frombuffer(mesh["attributes"][name]["array"].data, kind).reshape(-1, 3)


def _numbers(data: bytes, planes: int) -> np.ndarray:
    rows = np.frombuffer(data, np.uint8).reshape(planes, -1).astype(np.int64)
    return sum(row << (8 * plane) for plane, row in enumerate(rows))


def _columns(data: bytes, planes: int, count: int) -> np.ndarray:
    codes = _numbers(data, planes).reshape(-1, count)
    return np.cumsum(np.where(codes % 2, -(codes + 1) // 2, codes // 2), axis=1).T


def _index(mesh: dict[str, Any]) -> np.ndarray:
    index, following = [], 0
    for back in _numbers(mesh["index"], 4):
        index.append(following - back)
        following += back == 0
    return np.array(index)


def _unfolded(points: np.ndarray) -> np.ndarray:
    x, y = (2 * points / 254 - 1).T
    z = 1 - abs(x) - abs(y)
    side_x, side_y = np.where(x >= 0, 1, -1), np.where(y >= 0, 1, -1)
    normal = np.column_stack(
        [np.where(z < 0, (1 - abs(y)) * side_x, x), np.where(z < 0, (1 - abs(x)) * side_y, y), z]
    )
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def stl_points(path: Path) -> np.ndarray:
    """Distinct corners (n, 3) of a binary STL file."""
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.unique(np.fromfile(path, kind, offset=84)["corners"].reshape(-1, 3), axis=0)


def distance_between(held: np.ndarray, points: np.ndarray) -> float:
    """The largest distance from a point of either set to the other set, over the largest extent."""
    apart = max(cKDTree(a).query(b)[0].max() for a, b in ((held, points), (points, held)))
    return float(apart / np.ptp(points, axis=0).max())
