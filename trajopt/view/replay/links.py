"""The collision shapes of the links, as a layer over the drawn robot."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.collision.coal_shapes import thick
from trajopt.collision.shapes import LinkShape
from trajopt.view.replay.commands import Animation, without_shadow
from trajopt.view.replay.parts import ColouredMesh, ColouredMeshGeometry, colour_array, draw_capsule
from trajopt.view.replay.runs import DrawnSolution

SHAPE_COLOUR, SHAPE_OPACITY = 0x8E44AD, 0.45
# Scene tree node of the layer below a run's.
PLACE = "shapes"


def draw_shapes(run: DrawnSolution, tracks: Animation) -> None:
    """Draw the file's shapes of the links, and move them with their joints."""
    bodies, model = run.solution.description.bodies, run.solution.model
    drawn = set()
    for shape in bodies.shapes if bodies is not None else ():
        frame = model.frames[model.getFrameId(shape.frame)]
        joint = int(frame.parentJoint)
        node = run.node[PLACE][f"joint{joint}"]
        if joint > 0 and joint not in drawn:
            tracks.place(node, run.motion.joints[:, joint])
        drawn.add(joint)
        part = node[shape.name.replace("/", "_")]
        part.set_transform(frame.placement.homogeneous)
        _draw(part, shape)


def _draw(node: Any, shape: LinkShape) -> None:
    if len(shape.points) > 2:
        # A hull's radius is a fraction of a millimetre: moved outwards its corners show it well enough.
        away = shape.points - shape.points.mean(axis=0)
        away /= np.linalg.norm(away, axis=1)[:, None]
        _solid(node["solid"], _faces(shape.points + shape.radius * away), pin.SE3.Identity())
        return
    draw_capsule(node, shape.axis, shape.radius, _solid)


def _faces(points: np.ndarray) -> ColouredMeshGeometry:
    """Faces of the hull of points (n, 3) m, each with its own normal."""
    from scipy.spatial import ConvexHull  # takes a while to load

    solid = thick(points)
    hull = ConvexHull(solid)
    corners, outward = solid[hull.simplices], hull.equations[:, :3]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside_out = np.sum(turned * outward, axis=1) < 0
    corners[inside_out] = corners[inside_out][:, ::-1]
    flat = corners.reshape(-1, 3)
    normals, triangles = np.repeat(outward, 3, axis=0), np.arange(len(flat)).reshape(-1, 3)
    return ColouredMeshGeometry(ColouredMesh.joined([(flat, normals, colour_array(SHAPE_COLOUR), triangles)]))


def _solid(node: Any, geometry: Any, placement: pin.SE3) -> None:
    node.set_object(
        geometry, shapes.MeshLambertMaterial(color=SHAPE_COLOUR, opacity=SHAPE_OPACITY, transparent=True)
    )
    node.set_transform(placement.homogeneous)
    without_shadow(node)
