"""The robot of a replay: its visual meshes hung on the joints, or a skeleton where there are none."""

import warnings
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
from pinocchio.visualize.meshcat_visualizer import MeshcatVisualizer, loadMesh

from trajopt.collision.description import box_of_inertia
from trajopt.collision.shapes import box_corners
from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.robot.building import reach
from trajopt.robot.data import VisualSource
from trajopt.robot.geometry import DescribedGeometry, described_geometry, mesh_vertices
from trajopt.view.replay.collada import GREY, ColladaError, read_collada
from trajopt.view.replay.parts import ColouredMeshGeometry, placed

BONE_COLOUR, JOINT_COLOUR, FOOT_COLOUR = 0x8A93A0, 0x2F6DB5, 0x303438
# Radii of a skeleton over its reach.
BONE_RADIUS, JOINT_RADIUS = 0.012, 0.02
TRUNK_OPACITY = 0.7
# Points that represent a mesh's extent: some have a million vertices, tenths of a millimetre apart.
MOST_POINTS = 10_000
# Directions in which the extent of a round shape is sampled, to 2 % of its radius.
ROUND_PROBES = 200


def mesh_points(path: str, scale: Sequence[float] | np.ndarray, colour: np.ndarray = GREY) -> np.ndarray:
    """Points (k, 3) m of a mesh file in the frame of its geometry. Raises `InputError` if it is unreadable.

    ``colour`` (3,) is that of the drawing, so that the cached mesh is used.
    """
    if Path(path).suffix.lower() == ".dae":
        try:
            return np.asarray(read_collada(path, colour).vertices * np.asarray(scale), dtype=float)
        except (OSError, ColladaError):
            pass
    return mesh_vertices(path, scale)


@dataclass
class DrawnRobot:
    """Points of the drawn robot, (k, 3) m in the frame of each joint, and a note if meshes are missing."""

    points: dict[int, list[np.ndarray]] = field(default_factory=lambda: defaultdict(list))
    note: str = ""


def joint_path(model: pin.Model, joint: int) -> str:
    """Return the scene tree node that moves with ``joint``."""
    return "robot/" + str(model.names[joint]).replace("/", "_")


def draw_robot(vis: Any, solution: Solution) -> DrawnRobot:
    """Draw the robot of ``solution`` into the Meshcat node ``vis``: meshes if they are found, else bones."""
    try:
        visuals = visuals_of(solution.description.visual, solution.model)
    except InputError as error:
        name = solution.description.robot or solution.model.name or "robot"
        drawn = draw_skeleton(vis, solution)
        drawn.note = f"'{name}' is drawn as a skeleton: {error}"
        return drawn
    return _draw_meshes(vis, solution.model, visuals)


def visuals_of(source: VisualSource | None, model: pin.Model) -> DescribedGeometry:
    """Read a URDF file's visuals. Raises `InputError` if it, or every one of its meshes, is missing."""
    if not source:
        raise InputError("the solution names no URDF file")
    described = described_geometry(source, model, "visual")
    if described.missing and len(described.missing) == len(described.meshes):
        first = next(iter(described.missing.values()))
        raise InputError(f"meshes of {source.urdf} cannot be read: no mesh file {first} is found")
    if described.geometry.ngeoms == 0:
        raise InputError(f"{source.urdf} has no visual geometry")
    return described


class _JointTree(MeshcatVisualizer):
    """Pinocchio's loader of geometry and materials, with every geometry hung on its joint."""

    def getViewerNodeName(self, geometry_object: Any, geometry_type: Any) -> str:
        name = geometry_object.name.replace("/", "_")
        return f"{joint_path(self.model, geometry_object.parentJoint)}/{name}"

    def loadViewerGeometryObject(self, geometry_object: Any, *args: Any, **options: Any) -> None:
        if geometry_object.name in self.meshes:  # replaced by a box, see `described_geometry`
            geometry_object.geometry = coal.BVHModelOBBRSS()
        super().loadViewerGeometryObject(geometry_object, *args, **options)

    def loadMeshFromFile(self, geometry_object: Any) -> Any:
        if not geometry_object.meshPath.lower().endswith(".dae"):
            return super().loadMeshFromFile(geometry_object)
        try:
            mesh = read_collada(geometry_object.meshPath, np.asarray(geometry_object.meshColor)[:3])
        except ColladaError:
            return loadMesh(coal.MeshLoader().load(geometry_object.meshPath))  # of one colour
        return shapes.Mesh(ColouredMeshGeometry(mesh), shapes.MeshPhongMaterial(vertexColors=True))


def _draw_meshes(vis: Any, model: pin.Model, visuals: DescribedGeometry) -> DrawnRobot:
    loader, drawn = _JointTree(model, None, visuals.geometry), DrawnRobot()
    unreadable, not_shown = [], []
    loader.meshes = visuals.meshes
    loader.initViewer(viewer=vis)
    for entry in visuals.geometry.geometryObjects:
        try:
            vertices = _points(entry, entry.name in visuals.meshes)
        except InputError as error:
            unreadable.append(f"{entry.name} ({error.what})")
            continue
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            loader.loadViewerGeometryObject(entry, pin.GeometryType.VISUAL)
        if any(issubclass(warning.category, UserWarning) for warning in caught):
            not_shown.append(entry.name)
            continue
        node = vis[loader.getViewerNodeName(entry, pin.GeometryType.VISUAL)]
        scale = np.diag([*entry.meshScale, 1.0])
        node.set_transform(entry.placement.homogeneous @ scale)
        spread = subsample(vertices, MOST_POINTS)
        placed_points = spread @ entry.placement.rotation.T + entry.placement.translation
        drawn.points[entry.parentJoint].append(placed_points)
    reasons = {"mesh files that are not found": sorted(set(visuals.missing.values()))}
    reasons |= {"geometry that Meshcat cannot show": not_shown, "meshes": unreadable}
    parts = [f"without {what}: {', '.join(names)}" for what, names in reasons.items() if names]
    drawn.note = f"the robot is drawn {'; '.join(parts)}" if parts else ""
    return drawn


def _points(entry: Any, is_mesh: bool) -> np.ndarray:
    """Points (k, 3) that span a geometry, in its own frame, scaled, m. Raises `InputError`."""
    if is_mesh:
        return mesh_points(entry.meshPath, entry.meshScale, np.asarray(entry.meshColor)[:3])
    geometry = entry.geometry
    if isinstance(geometry, coal.Sphere):
        return geometry.radius * _round_probes()
    geometry.computeLocalAABB()
    return box_corners(geometry.aabb_local.min_, geometry.aabb_local.max_)


def subsample(points: np.ndarray, most: int) -> np.ndarray:
    """Return about ``most`` of many points (k, 3), including those furthest along the axes."""
    if len(points) <= most:
        return points
    furthest = np.concatenate([points.argmin(axis=0), points.argmax(axis=0)])
    return np.concatenate([points[:: len(points) // most], points[furthest]])


def _round_probes() -> np.ndarray:
    """Evenly spread directions (k, 3): a Fibonacci lattice on the sphere."""
    k = np.arange(ROUND_PROBES) + 0.5
    height, angle = 1 - 2 * k / ROUND_PROBES, np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def draw_skeleton(vis: Any, solution: Solution) -> DrawnRobot:
    """Draw joints as spheres, links as rods from joint to joint, and rods to contacts and tips."""
    model, drawn = solution.model, DrawnRobot()
    size, base = reach(model) or 1.0, BASE_JOINT[base_of(model)]
    bone, ball = BONE_RADIUS * size, JOINT_RADIUS * size
    for joint in range(max(base, 1), model.njoints):  # virtual joints are not drawn
        node = vis[joint_path(model, joint)]
        node["joint"].set_object(shapes.Sphere(ball), shapes.MeshPhongMaterial(color=JOINT_COLOUR))
        drawn.points[joint].append(np.zeros((1, 3)))
    for number, (joint, end, is_tip) in enumerate(_rods(solution, base)):
        node, length = vis[joint_path(model, joint)], float(np.linalg.norm(end))
        drawn.points[joint].append(end[None])
        if is_tip:
            node[f"tip{number}"].set_object(shapes.Sphere(ball), shapes.MeshPhongMaterial(color=FOOT_COLOUR))
            node[f"tip{number}"].set_transform(placed(end))
            drawn.points[joint].append(end + ball * _round_probes())
        if length > ball:
            rod = shapes.Cylinder(length, bone)
            node[f"rod{number}"].set_object(rod, shapes.MeshPhongMaterial(color=BONE_COLOUR))
            along = pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), end)  # Meshcat's lie along y
            node[f"rod{number}"].set_transform(placed(end / 2, along.toRotationMatrix()))
    if base and (box := box_of_inertia(model.inertias[base])):  # a moving base has no rod
        sides, place = box
        trunk = vis[joint_path(model, base)]["trunk"]
        material = shapes.MeshPhongMaterial(color=BONE_COLOUR, opacity=TRUNK_OPACITY)
        trunk.set_object(shapes.Box(sides.tolist()), material)
        trunk.set_transform(place.homogeneous)
        corners = box_corners(-sides / 2, sides / 2)
        drawn.points[base].append(corners @ place.rotation.T + place.translation)
    return drawn


def _rods(solution: Solution, base: int) -> list[tuple[int, np.ndarray, bool]]:
    """(joint, end in its frame, is a tip) of every rod: to child joints, contact frames and tips."""
    model, rods = solution.model, []
    for child in range(base + 1, model.njoints):
        parent = int(model.parents[child])
        if parent > 0 or model.joints[child].nv == 1:  # a floating base has no rod
            rods.append((parent, model.jointPlacements[child].translation.copy(), False))
    tips = {model.getFrameId(name) for name in solution.contact_frames} | set(tip_frames(model))
    for frame in (model.frames[number] for number in sorted(tips)):
        rods.append((int(frame.parentJoint), frame.placement.translation.copy(), True))
    return rods


def tip_frames(model: pin.Model) -> list[int]:
    """Return, for each joint without a child, the frame on it that lies furthest away."""
    lengths = [np.linalg.norm(frame.placement.translation) for frame in model.frames]
    leaves = set(range(1, model.njoints)) - {int(parent) for parent in model.parents}
    frames = ([i for i, f in enumerate(model.frames) if f.parentJoint == joint] for joint in sorted(leaves))
    return [max(ends, key=lengths.__getitem__) for ends in frames if ends]
