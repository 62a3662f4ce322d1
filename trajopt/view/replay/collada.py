"""Triangles, normals and colours of a COLLADA file.

Meshcat's own reader drops parts of files in which one geometry has several materials, common for arms. This
one reads the contents of description files: triangles and polygons under a tree of nodes, with plain colours;
textures are not read. Anything else raises `ColladaError`. Numbers are taken as they are, in m and without
turning the file's up axis, as Pinocchio takes them.
"""

import xml.etree.ElementTree as Tree
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.view.replay.parts import ColouredMesh, MeshPart

TRANSFORMATIONS = ("matrix", "translate", "scale", "rotate")
# Most files in the cache.
MOST_FILES = 64
GREY = np.array([0.8, 0.8, 0.8])


class ColladaError(ValueError):
    """The file is not COLLADA, or holds something other than coloured triangles."""


def read_collada(path: str | Path, plain: np.ndarray = GREY) -> ColouredMesh:
    """Read the mesh of a file, in m; ``plain`` (3,) colours parts without a plain colour in the file.

    Raises `ColladaError`, or `OSError` if the file cannot be opened.
    """
    file = Path(path)
    return _read(file, file.stat().st_mtime, tuple(float(part) for part in plain))


@lru_cache(maxsize=MOST_FILES)
def _read(path: Path, changed: float, plain: tuple[float, ...]) -> ColouredMesh:
    """Read a file with modification time ``changed``; cached, as robots use a file several times."""
    try:
        root = Tree.parse(path).getroot()
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        return _Reader(root, np.array(plain)).mesh()
    except (Tree.ParseError, KeyError, IndexError, StopIteration, ValueError) as error:
        raise ColladaError(f"{path}: {error}") from None


class _Reader:
    def __init__(self, root: Tree.Element, plain: np.ndarray) -> None:
        self._plain = plain
        self._root = root
        self._by_id = {f"#{element.get('id')}": element for element in root.iter() if element.get("id")}
        self._parts: list[MeshPart] = []

    def mesh(self) -> ColouredMesh:
        for node in self._child(self._root, "scene/instance_visual_scene", "url"):
            self._node(node, np.eye(4))
        if not self._parts:
            raise ColladaError("no triangles")
        return ColouredMesh.joined(self._parts)

    def _child(self, parent: Tree.Element, path: str, attribute: str) -> Tree.Element:
        """The element to which an element below ``parent`` refers."""
        reference = parent.find(path)
        if reference is None:
            raise ColladaError(f"no {path}")
        return self._by_id[reference.get(attribute, "")]

    def _node(self, node: Tree.Element, parent: np.ndarray) -> None:
        if node.tag != "node":
            return
        placement = parent @ _transform(node)
        for child in node:
            if child.tag == "node":
                self._node(child, placement)
            elif child.tag == "instance_node":
                self._node(self._by_id[child.get("url", "")], placement)
            elif child.tag == "instance_geometry":
                self._geometry(child, placement)
            elif child.tag == "instance_controller":
                raise ColladaError("skins are not read")

    def _geometry(self, instance: Tree.Element, placement: np.ndarray) -> None:
        bound = {entry.get("symbol"): entry.get("target", "") for entry in instance.iter("instance_material")}
        rotation = np.ascontiguousarray(placement[:3, :3].T)  # without a copy it takes three times as long
        turn = np.linalg.inv(placement[:3, :3])  # normals transform with the inverse transpose
        for primitive in self._by_id[instance.get("url", "")].iterfind("mesh/*"):
            if primitive.tag in ("triangles", "polylist"):
                points, normals, index = self._corners(primitive)
                points, normals = points @ rotation + placement[:3, 3], normals @ turn
                if np.linalg.det(placement[:3, :3]) < 0:
                    index = index.reshape(-1, 3)[:, ::-1].ravel()
                length = np.linalg.norm(normals, axis=1, keepdims=True)
                colour = self._colour(bound.get(primitive.get("material")))
                self._parts.append((points, normals / np.where(length > 0, length, 1.0), colour, index))

    def _corners(self, primitive: Tree.Element) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and normals (n, 3) of distinct corners, and the index of each triangle corner in them."""
        inputs = {entry.get("semantic"): entry for entry in primitive.findall("input")}
        stride = 1 + max(int(entry.get("offset", 0)) for entry in primitive.findall("input"))
        index = np.fromstring(primitive.findtext("p") or "", dtype=int, sep=" ").reshape(-1, stride)
        if primitive.tag == "polylist":
            index = index[_fans(np.fromstring(primitive.findtext("vcount") or "", dtype=int, sep=" "))]
        vertices = self._by_id[inputs["VERTEX"].get("source", "")]
        attributes = {entry.get("semantic"): entry for entry in vertices.findall("input")}
        at = index[:, int(inputs["VERTEX"].get("offset", 0))]
        positions = self._source(attributes["POSITION"])
        if "NORMAL" in inputs:
            turned = index[:, int(inputs["NORMAL"].get("offset", 0))]
            normals = self._source(inputs["NORMAL"])
            if index.min(initial=0) < 0 or turned.max(initial=0) >= len(normals):
                raise ColladaError("a triangle with a missing normal")
            pairs, corner = np.unique(at * len(normals) + turned, return_inverse=True)
            return positions[pairs // len(normals)], normals[pairs % len(normals)], corner
        if "NORMAL" in attributes:
            used, corner = np.unique(at, return_inverse=True)
            return positions[used], self._source(attributes["NORMAL"])[used], corner
        points = positions[at]
        sides = points.reshape(-1, 3, 3)
        flat = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
        return points, np.repeat(flat, 3, axis=0), np.arange(len(points))

    def _source(self, entry: Tree.Element) -> np.ndarray:
        source = self._by_id[entry.get("source", "")]
        accessor = next(source.iter("accessor"))
        stride = int(accessor.get("stride", 1))
        numbers = np.fromstring(source.findtext("float_array") or "", sep=" ")
        return numbers.reshape(-1, stride)[:, :3]

    def _colour(self, material: str | None) -> np.ndarray:
        if material is None:
            return self._plain
        effect = self._child(self._by_id[material], "instance_effect", "url")
        text = effect.findtext(".//diffuse/color")
        return np.array(text.split()[:3], dtype=float) if text else self._plain


def _transform(node: Tree.Element) -> np.ndarray:
    """Placement (4, 4) of a node in its parent: its transformations in file order."""
    result = np.eye(4)
    for element in node:
        if element.tag not in TRANSFORMATIONS:
            continue
        step, numbers = np.eye(4), np.array((element.text or "").split(), dtype=float)
        if element.tag == "matrix":
            step = numbers.reshape(4, 4)
        elif element.tag == "translate":
            step[:3, 3] = numbers
        elif element.tag == "scale":
            step[:3, :3] = np.diag(numbers)
        elif element.tag == "rotate":
            axis = numbers[:3] / np.linalg.norm(numbers[:3])
            step[:3, :3] = pin.AngleAxis(np.radians(numbers[3]), axis).toRotationMatrix()
        result = result @ step
    return result


def _fans(counts: np.ndarray) -> np.ndarray:
    """Indices of the corners of triangles into which polygons of ``counts`` corners are cut."""
    first = np.cumsum(counts) - counts
    triangles = [
        (start, start + k, start + k + 1)
        for start, count in zip(first.tolist(), counts.tolist(), strict=True)
        for k in range(1, count - 1)
    ]
    return np.array(triangles, dtype=int).ravel()
