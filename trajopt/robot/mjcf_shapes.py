"""Geoms of a compiled MJCF file as shapes on a model, and the pairs of bodies that the file excludes."""

from collections import Counter
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from trajopt.robot.mjcf import body_names, compile_mjcf, placement, robot_bodies, unique
from trajopt.robot.mujoco_package import mujoco_package

# Groups that MuJoCo draws unless asked for others; by custom, geoms that only collide are in the others.
DRAWN_GROUPS = 3


def mjcf_geometry(path: Path, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    """Geoms of the robot that touch, or that are drawn, on the frames of their bodies. Raises InputError."""
    compiled = compile_mjcf(path)
    wanted = np.isin(compiled.geom_bodyid, robot_bodies(compiled))
    chosen = (compiled.geom_contype | compiled.geom_conaffinity) != 0
    if kind == pin.GeometryType.VISUAL:
        chosen = compiled.geom_group < DRAWN_GROUPS
        chosen = chosen if (chosen & wanted).any() else np.ones_like(wanted)
    geometry, names = pin.GeometryModel(), body_names(compiled)
    taken, counts = set[str](), Counter[str]()
    for index in np.flatnonzero(wanted & chosen).tolist():
        body, shape = names[compiled.geom_bodyid[index]], _shape(compiled, index)
        if shape is None or not model.existFrame(body, pin.FrameType.BODY):
            continue
        frame = model.getFrameId(body, pin.FrameType.BODY)
        on = model.frames[frame]
        place = on.placement * placement(compiled.geom_pos[index], compiled.geom_quat[index])
        given = mujoco_package().mj_id2name(compiled, mujoco_package().mjtObj.mjOBJ_GEOM, index)
        name = unique(given or f"{body}_{counts[body]}", taken)
        counts[body] += 1
        material = int(compiled.geom_matid[index])
        colour = compiled.geom_rgba[index] if material < 0 else compiled.mat_rgba[material]
        entry = pin.GeometryObject(
            name, on.parentJoint, frame, place, shape, "", np.ones(3), True, colour.astype(float)
        )
        geometry.addGeometryObject(entry)
    return geometry


def _shape(compiled: Any, index: int) -> Any:
    """Coal's shape of a geom; None for a plane, a height field or a signed distance field."""
    kinds, kind = mujoco_package().mjtGeom, compiled.geom_type[index]
    x, y, z = (float(size) for size in compiled.geom_size[index])
    if kind == kinds.mjGEOM_MESH:
        return _mesh(compiled, int(compiled.geom_dataid[index]))
    made = {
        kinds.mjGEOM_SPHERE: lambda: coal.Sphere(x),
        kinds.mjGEOM_CAPSULE: lambda: coal.Capsule(x, 2 * y),
        kinds.mjGEOM_CYLINDER: lambda: coal.Cylinder(x, 2 * y),
        kinds.mjGEOM_BOX: lambda: coal.Box(2 * x, 2 * y, 2 * z),
        kinds.mjGEOM_ELLIPSOID: lambda: coal.Ellipsoid(x, y, z),
    }
    return next((make() for each, make in made.items() if int(each) == kind), None)


def _mesh(compiled: Any, mesh: int) -> Any:
    corner, face = int(compiled.mesh_vertadr[mesh]), int(compiled.mesh_faceadr[mesh])
    corners = compiled.mesh_vert[corner : corner + int(compiled.mesh_vertnum[mesh])].astype(float)
    faces = compiled.mesh_face[face : face + int(compiled.mesh_facenum[mesh])]
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(faces), len(corners))
    shape.addVertices(corners)
    shape.addTriangles(faces.astype(np.int64))
    shape.endModel()
    return shape


def excluded_bodies(path: Path) -> set[frozenset[str]]:
    """Pairs of bodies that ``<exclude>`` names. Raises InputError."""
    compiled = compile_mjcf(path)
    names = body_names(compiled)
    return {frozenset((names[pair >> 16], names[pair & 0xFFFF])) for pair in compiled.exclude_signature}
