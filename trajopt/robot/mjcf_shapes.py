"""Geoms of a compiled MJCF file as shapes on a model, and pairs of bodies excluded from collision."""

from collections import Counter
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.robot.mjcf import body_names, compile_mjcf, placement, robot_bodies, unique

# MuJoCo draws groups below this by default; by convention, geoms that only collide are in higher ones.
DRAWN_GROUPS = 3
# MuJoCo's mjtGeom; planes, height fields and distance fields are not parts of robots.
MESH = 7
KINDS = {
    2: lambda x, y, z: coal.Sphere(x),
    3: lambda x, y, z: coal.Capsule(x, 2 * y),
    4: lambda x, y, z: coal.Ellipsoid(x, y, z),
    5: lambda x, y, z: coal.Cylinder(x, 2 * y),
    6: lambda x, y, z: coal.Box(2 * x, 2 * y, 2 * z),
}


def mjcf_geometry(path: Path, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    """Collision or visual geoms of the robot, on the frames of their bodies. Raises `InputError`."""
    compiled = compile_mjcf(path)
    own = np.isin(compiled.geom_bodyid, robot_bodies(compiled))
    own &= np.isin(compiled.geom_type, [*KINDS, MESH])
    chosen = (compiled.geom_contype | compiled.geom_conaffinity) != 0
    if kind == pin.GeometryType.VISUAL:
        chosen = compiled.geom_group < DRAWN_GROUPS
        chosen |= not (chosen & own).any()
    geometry, names = pin.GeometryModel(), body_names(compiled)
    taken, counts = set[str](), Counter[str]()
    for index in np.flatnonzero(own & chosen).tolist():
        geom = compiled.geom(index)
        body, material = names[geom.bodyid[0]], int(geom.matid[0])
        if not model.existFrame(body, pin.FrameType.BODY):
            continue
        frame = model.getFrameId(body, pin.FrameType.BODY)
        on, name = model.frames[frame], unique(geom.name or f"{body}_{counts[body]}", taken)
        counts[body] += 1
        shape = (
            _mesh(compiled, int(geom.dataid[0])) if geom.type[0] == MESH else KINDS[geom.type[0]](*geom.size)
        )
        place = on.placement * placement(geom.pos, geom.quat)
        colour = np.array(geom.rgba if material < 0 else compiled.mat_rgba[material], dtype=float)
        entry = (name, on.parentJoint, frame, place, shape, "", np.ones(3), True, colour)
        geometry.addGeometryObject(pin.GeometryObject(*entry))
    return geometry


def _mesh(compiled: Any, mesh: int) -> Any:
    corner, face = compiled.mesh_vertadr[mesh], compiled.mesh_faceadr[mesh]
    corners = compiled.mesh_vert[corner : corner + compiled.mesh_vertnum[mesh]].astype(float)
    faces = compiled.mesh_face[face : face + compiled.mesh_facenum[mesh]].astype(np.int64)
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(faces), len(corners))
    shape.addVertices(corners)
    shape.addTriangles(faces)
    shape.endModel()
    return shape


def excluded_bodies(path: Path) -> set[frozenset[str]]:
    """Pairs of bodies in ``<exclude>`` elements. Raises `InputError`."""
    compiled = compile_mjcf(path)
    names = body_names(compiled)
    return {frozenset((names[pair >> 16], names[pair & 0xFFFF])) for pair in compiled.exclude_signature}
