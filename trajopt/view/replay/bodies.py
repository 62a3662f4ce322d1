"""Bodies of a replay besides the robot: obstacles and payloads."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import BoxObstacle, Obstacle
from trajopt.solution.description import CarriedBody
from trajopt.solution.solution import Solution
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.parts import box_corners, draw_capsule, placed
from trajopt.view.replay.robot import box_of_inertia
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.thinning import hold_while_hidden

OBSTACLE_COLOUR, OBSTACLE_OPACITY = 0xC1553B, 0.75
_CORNERS = box_corners(-np.ones(3), np.ones(3))
PAYLOAD_COLOUR = 0xC98A2B
# A point mass is drawn as a ball of this density, kg/m^3: between wood and water.
DENSITY = 800.0


def draw_obstacles(run: DrawnSolution) -> np.ndarray:
    """Draw the obstacles; returns their corners (k, 3), world, m."""
    corners = [np.zeros((0, 3))]
    for obstacle in run.solution.description.obstacles:
        corners.append(_draw_obstacle(run.node["obstacles"][obstacle.name.replace("/", "_")], obstacle))
    return np.concatenate(corners)


def _draw_obstacle(node: Any, obstacle: Obstacle) -> np.ndarray:
    if isinstance(obstacle, BoxObstacle):
        placement = pin.SE3(obstacle.turn, obstacle.position)
        _solid(node, shapes.Box(obstacle.sides.tolist()), placement)
        return np.asarray(_CORNERS * obstacle.sides / 2 @ obstacle.turn.T + obstacle.position)
    draw_capsule(node, obstacle.axis, obstacle.radius, _solid)
    return np.concatenate([place + obstacle.radius * _CORNERS for place in obstacle.axis])


def _solid(node: Any, shape: Any, placement: pin.SE3) -> None:
    material = shapes.MeshLambertMaterial(color=OBSTACLE_COLOUR, opacity=OBSTACLE_OPACITY)
    node.set_object(shape, material)
    node.set_transform(placement.homogeneous)


def draw_payloads(run: DrawnSolution, tracks: Animation) -> np.ndarray:
    """Animate payloads; returns points (k, 3) of their extent, m, world."""
    solution, motion, places = run.solution, run.motion, [np.zeros((0, 3))]
    for number, (carried_body, phases) in enumerate(_bodies(solution)):
        contact = solution.contact_frames.index(carried_body.frame)
        carried = np.isin(motion.phase, phases)
        if not carried.any():
            continue
        body, part = carried_body.spatial, run.node["payloads"][f"body{number}"]
        extent = _draw_payload(part["shape"], body)
        # Before it is taken and after it is put down it stays in place.
        hand = hold_while_hidden(motion.contacts[:, contact], carried)
        tracks.place(part, hand)
        centres = hand[:, :3, :3] @ body.lever + hand[:, :3, 3]
        places += [centres - extent, centres + extent]
    return np.concatenate(places)


def _bodies(solution: Solution) -> list[tuple[CarriedBody, list[int]]]:
    """Each carried body with its phases; a description has a body once for each phase."""
    bodies: list[tuple[CarriedBody, list[int]]] = []
    for body in solution.description.payloads:
        same = [
            phases for other, phases in bodies if other.frame == body.frame and other.spatial == body.spatial
        ]
        if same:
            same[0].extend(body.phases)
        else:
            bodies.append((body, list(body.phases)))
    return bodies


def _draw_payload(node: Any, body: pin.Inertia) -> float:
    """A box of the body's mass and inertia, or a ball for a point; returns half its extent, m."""
    material = shapes.MeshLambertMaterial(color=PAYLOAD_COLOUR)
    box = box_of_inertia(body)
    if box is not None:
        sides, placement = box
        node.set_object(shapes.Box(sides.tolist()), material)
        node.set_transform(placement.homogeneous)
        return float(np.linalg.norm(sides)) / 2
    radius = float((3 * max(body.mass, 1e-6) / (4 * np.pi * DENSITY)) ** (1 / 3))
    node.set_object(shapes.Sphere(radius), material)
    node.set_transform(placed(body.lever))
    return radius
