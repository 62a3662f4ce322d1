"""The visual geometry of a URDF file, without the data for collision detection with its meshes.

Pinocchio reads every mesh into a tree of bounding volumes, which takes most of the time of a replay and fails
if one file is missing. Here Pinocchio places boxes where the file has meshes; the files stay on disk until
they are drawn, and each missing one is reported.
"""

from __future__ import annotations

import xml.etree.ElementTree as Tree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, first_line
from trajopt.robot.data import VisualSource
from trajopt.view.replay.collada import GREY, ColladaError, read_collada
from trajopt.view.replay.meshes import stl_corners

SCHEMES = ("package://", "model://", "file://")


@dataclass(frozen=True, kw_only=True)
class Visuals:
    """Visual geometries placed on a model; their mesh files by name; names and files of missing ones."""

    geometry: pin.GeometryModel
    meshes: frozenset[str]
    missing: dict[str, str]


def visuals_of(source: VisualSource, model: pin.Model) -> Visuals:
    """Read a URDF file's visuals. Raises `InputError` if it, or every one of its meshes, is missing."""
    if not source.urdf.is_file():
        raise InputError(f"URDF file {source.urdf} of the robot's meshes does not exist")
    try:
        root = Tree.parse(source.urdf).getroot()
        files = _boxes_for_meshes(root)
        text = Tree.tostring(root, encoding="unicode")
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
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
    if missing and len(missing) == len(files):
        first = next(iter(missing.values()))
        raise InputError(f"meshes of {source.urdf} cannot be read: no mesh file {first} is found")
    return Visuals(geometry=geometry, meshes=frozenset(files), missing=missing)


def _boxes_for_meshes(root: Tree.Element) -> dict[str, tuple[str, np.ndarray]]:
    """Put a box for every visual mesh; returns file and scale (3,) by Pinocchio's name of the geometry."""
    files = {}
    for link in root.iter("link"):
        for number, visual in enumerate(link.findall("visual")):
            holder = visual.find("geometry")
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


def mesh_points(path: str, scale: Sequence[float] | np.ndarray, colour: np.ndarray = GREY) -> np.ndarray:
    """Points (k, 3) m of a mesh file in the frame of its geometry. Raises `InputError` if it is unreadable.

    ``colour`` (3,): its colour in the drawing, so that the cached mesh is used.
    """
    file = Path(path)
    points = None
    try:
        if file.suffix.lower() == ".stl":
            points = stl_corners(file.read_bytes())
        elif file.suffix.lower() == ".dae":
            points = read_collada(file, colour).vertices
    except (OSError, ColladaError):
        pass
    if points is not None:
        return np.asarray(points * np.asarray(scale), dtype=float)
    try:
        mesh = coal.MeshLoader().load(path, np.asarray(scale, dtype=float))
        return np.array(mesh.vertices())
    except (RuntimeError, ValueError) as error:
        raise InputError(f"mesh file {path} cannot be read: {str(error).strip()}") from None
