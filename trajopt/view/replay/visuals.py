"""The visual geometry of a URDF file, and the points of its meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.robot.data import VisualSource
from trajopt.robot.geometry import DescribedGeometry, described_geometry, mesh_vertices
from trajopt.view.replay.collada import GREY, ColladaError, read_collada


def visuals_of(source: VisualSource, model: pin.Model) -> DescribedGeometry:
    """Read a URDF file's visuals. Raises `InputError` if it, or every one of its meshes, is missing."""
    described = described_geometry(source, model, "visual")
    if described.missing and len(described.missing) == len(described.meshes):
        first = next(iter(described.missing.values()))
        raise InputError(f"meshes of {source.urdf} cannot be read: no mesh file {first} is found")
    return described


def mesh_points(path: str, scale: Sequence[float] | np.ndarray, colour: np.ndarray = GREY) -> np.ndarray:
    """Points (k, 3) m of a mesh file in the frame of its geometry. Raises `InputError` if it is unreadable.

    ``colour`` (3,): its colour in the drawing, so that the cached mesh is used.
    """
    if Path(path).suffix.lower() == ".dae":
        try:
            return np.asarray(read_collada(path, colour).vertices * np.asarray(scale), dtype=float)
        except (OSError, ColladaError):
            pass
    return mesh_vertices(path, scale)
