"""Obstacles of a replay: the boxes, capsules and spheres that the robot stays clear of."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.robot.collision.shapes import BoxObstacle, CapsuleObstacle, Obstacle, segment_placement
from trajopt.solution.descriptions import scene_of_meta
from trajopt.view.replay.parts import UPRIGHT, box_corners
from trajopt.view.replay.runs import DrawnSolution

OBSTACLE_COLOUR, OBSTACLE_OPACITY = 0xC1553B, 0.75
_CORNERS = box_corners(-np.ones(3), np.ones(3))


def draw_obstacles(run: DrawnSolution) -> np.ndarray:
    """Draw what the robot stays clear of; returns the corners (k, 3), world, m."""
    scene = scene_of_meta(run.solution.model, run.solution.meta.get("collision"))
    corners = [np.zeros((0, 3))]
    for obstacle in scene.obstacles if scene is not None else ():
        corners.append(_draw(run.node["obstacles"][obstacle.name.replace("/", "_")], obstacle))
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
        placement = segment_placement(start, end) * pin.SE3(UPRIGHT, np.zeros(3))
        _solid(node["side"], shapes.Cylinder(length, obstacle.radius), placement)
    return np.concatenate([place + obstacle.radius * _CORNERS for place in (start, end)])


def _solid(node: Any, shape: Any, placement: pin.SE3) -> None:
    material = shapes.MeshLambertMaterial(color=OBSTACLE_COLOUR, opacity=OBSTACLE_OPACITY)
    node.set_object(shape, material)
    node.set_transform(placement.homogeneous)
