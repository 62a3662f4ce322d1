"""The geometry of a robot's description, placed on its model; missing mesh files are reported.

Pinocchio reads every mesh of a URDF into a tree of bounding volumes, which takes most of the time and fails
if one file is missing. Here Pinocchio places boxes where the file has meshes; the files stay on disk until
their points are needed.
"""

import xml.etree.ElementTree as Tree
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import coal
import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, first_line
from trajopt.robot.data import VisualSource

SCHEMES = ("package://", "model://", "file://")
# A binary STL file has a header that ends with the number of triangles, and 50 bytes for each triangle.
STL_HEADER = 84
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Mesh files whose points are kept once read: robots use one file several times.
MOST_FILES = 128

Purpose = Literal["visual", "collision"]
_TYPES = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}


@dataclass(frozen=True, kw_only=True)
class DescribedGeometry:
    """Geometries placed on a model, names of those that are meshes, and missing files by name."""

    geometry: pin.GeometryModel
    meshes: frozenset[str]
    missing: dict[str, str]


def described_geometry(source: VisualSource, model: pin.Model, purpose: Purpose) -> DescribedGeometry:
    """Read the visual or collision geometry of a description. Raises `InputError` if it cannot be read."""
    if source.is_mjcf:
        geometry = source.geometry(model, _TYPES[purpose])
        return DescribedGeometry(geometry=geometry, meshes=frozenset(), missing={})
    if not source.urdf.is_file():
        raise InputError(f"URDF file {source.urdf} of the robot's meshes does not exist")
    try:
        root = Tree.parse(source.urdf).getroot()
        files = _boxes_for_meshes(root, purpose)
        text = Tree.tostring(root, encoding="unicode")
        geometry = pin.buildGeomFromUrdfString(model, text, _TYPES[purpose])
    except (Tree.ParseError, ValueError, RuntimeError) as error:
        raise InputError(f"meshes of {source.urdf} cannot be read: {first_line(error)}") from None
    paths = {name: _located(uri, source) for name, (uri, _) in files.items()}
    missing = {name: files[name][0] for name, path in paths.items() if path is None}
    for name in missing:
        if geometry.existGeometryName(name):  # the model may lack a link
            geometry.removeGeometryObject(name)
    for entry in geometry.geometryObjects:
        if entry.name in files:
            entry.meshPath, entry.meshScale = str(paths[entry.name]), files[entry.name][1]
    return DescribedGeometry(geometry=geometry, meshes=frozenset(files), missing=missing)


def _boxes_for_meshes(root: Tree.Element, purpose: Purpose) -> dict[str, tuple[str, np.ndarray]]:
    """Replace every mesh with a box; return file and scale (3,) by Pinocchio's name of the geometry."""
    files = {}
    for link in root.iter("link"):
        for number, element in enumerate(link.findall(purpose)):
            holder = element.find("geometry")
            mesh = None if holder is None else holder.find("mesh")
            if holder is None or mesh is None:
                continue
            scale = np.array((mesh.get("scale") or "1 1 1").split(), dtype=float)
            files[f"{link.get('name')}_{number}"] = (mesh.get("filename", ""), scale)
            holder.remove(mesh)
            Tree.SubElement(holder, "box", size="1 1 1")
    return files


def _located(name: str, source: VisualSource) -> Path | None:
    """The file of a mesh's URI; None if it is not found."""
    scheme = next((scheme for scheme in SCHEMES if name.startswith(scheme)), "")
    rest = name.removeprefix(scheme)
    places = [Path(rest)] if scheme == "file://" or Path(rest).is_absolute() else []
    if not places:
        places = [directory / rest for directory in source.package_dirs]
        places += [] if scheme else [source.urdf.parent / rest]
    return next((place for place in places if place.is_file()), None)


def mesh_vertices(path: str | Path, scale: Sequence[float] | np.ndarray) -> np.ndarray:
    """Points (k, 3) m of a mesh file in its geometry's frame. Raises `InputError` if it is unreadable."""
    file = Path(path)
    try:
        return np.asarray(_vertices(file, file.stat().st_mtime_ns) * np.asarray(scale), dtype=float)
    except (RuntimeError, ValueError, OSError) as error:
        cause = first_line(error).removeprefix(f"Could not load resource {path}: ")
        raise InputError(f"mesh file {path} cannot be read: {cause}") from None


@lru_cache(maxsize=MOST_FILES)
def _vertices(path: Path, _changed: int) -> np.ndarray:
    points = stl_corners(path.read_bytes()) if path.suffix.lower() == ".stl" else None
    if points is None:
        points = np.array(coal.MeshLoader().load(str(path), np.ones(3)).vertices())
    if not len(points):
        raise ValueError("it has no points")
    return points.astype(float)


def stl_corners(data: bytes) -> np.ndarray | None:
    """Corners (3m, 3) of the m triangles of a binary file; None if its length does not fit, as for text."""
    count = (len(data) - STL_HEADER) // STL_TRIANGLE.itemsize
    if count < 0 or len(data) != STL_HEADER + count * STL_TRIANGLE.itemsize:
        return None
    return np.asarray(np.frombuffer(data, STL_TRIANGLE, count, STL_HEADER)["corners"].reshape(-1, 3))
