"""Obstacles of a replay: the boxes, capsules and spheres that the robot stays clear of."""

from __future__ import annotations

import itertools
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.robot.collision.shapes import BoxObstacle, CapsuleObstacle, Obstacle, segment_placement
from trajopt.solution.descriptions import scene_of_meta
from trajopt.solution.solution import Solution

OBSTACLE_COLOUR, OBSTACLE_OPACITY = 0xC1553B, 0.75
# Meshcat's cylinder lies along y, a segment's placement has its axis along z.
TO_CYLINDER = pin.utils.rotate("x", np.pi / 2)
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def draw_obstacles(vis: Any, solution: Solution) -> np.ndarray:
    """Draw the obstacles of ``solution`` below the node ``vis``; returns their corners (k, 3), world, m."""
    scene = scene_of_meta(solution.model, solution.meta.get("collision"))
    corners = [np.zeros((0, 3))]
    for obstacle in scene.obstacles if scene is not None else ():
        corners.append(_draw(vis[obstacle.name.replace("/", "_")], obstacle))
    return np.concatenate(corners)


def _draw(node: Any, obstacle: Obstacle) -> np.ndarray:
    if isinstance(obstacle, BoxObstacle):
        placement = pin.SE3(obstacle.turn, obstacle.position)
        _solid(node, shapes.Box(obstacle.sides.tolist()), placement)
        return np.asarray(_CORNERS * obstacle.sides / 2 @ obstacle.turn.T + obstacle.position)
    start, end = obstacle.axis
    _solid(node["start"], shapes.Sphere(obstacle.radius), pin.SE3(np.eye(3), start))
    length = float(np.linalg.norm(end - start))
    if isinstance(obstacle, CapsuleObstacle) and length > 0:
        _solid(node["end"], shapes.Sphere(obstacle.radius), pin.SE3(np.eye(3), end))
        placement = segment_placement(start, end) * pin.SE3(TO_CYLINDER, np.zeros(3))
        _solid(node["side"], shapes.Cylinder(length, obstacle.radius), placement)
    return np.concatenate([place + obstacle.radius * _CORNERS for place in (start, end)])


def _solid(node: Any, shape: Any, placement: pin.SE3) -> None:
    material = shapes.MeshLambertMaterial(color=OBSTACLE_COLOUR, opacity=OBSTACLE_OPACITY)
    node.set_object(shape, material)
    node.set_transform(placement.homogeneous)
