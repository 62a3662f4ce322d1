"""Bodies of a replay besides the drawn robot: obstacles, payloads, the collision shapes of its links."""

from functools import partial
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.collision.coal_shapes import thicken
from trajopt.collision.description import box_of_inertia
from trajopt.collision.shapes import BoxObstacle, LinkShape, Obstacle, box_corners
from trajopt.motion.description import CarriedBody
from trajopt.motion.solution import Solution
from trajopt.terrain.bodies import convex_hull
from trajopt.view.replay.commands import Animation, hold_while_hidden, without_shadow
from trajopt.view.replay.parts import ColouredMeshGeometry, Solid, colour_array, draw_capsule
from trajopt.view.replay.runs import DrawnSolution

OBSTACLE_COLOUR, OBSTACLE_OPACITY = 0xC1553B, 0.75
_CORNERS = box_corners(-np.ones(3), np.ones(3))
PAYLOAD_COLOUR = 0xC98A2B
# A point mass is drawn as a ball of this density, kg/m^3: between wood and water.
DENSITY = 800.0
# A shape smaller than this, m, is a point mass.
LEAST_EXTENT = 1e-3
SHAPE_COLOUR, SHAPE_OPACITY = 0x8E44AD, 0.45


def draw_obstacles(run: DrawnSolution) -> np.ndarray:
    """Draw the obstacles; returns their corners (k, 3), world, m."""
    corners = [np.zeros((0, 3))]
    for obstacle in run.solution.description.obstacles:
        corners.append(_draw_obstacle(run.node["obstacles"][obstacle.name.replace("/", "_")], obstacle))
    return np.concatenate(corners)


def _draw_obstacle(node: Any, obstacle: Obstacle) -> np.ndarray:
    solid = partial(_solid, color=OBSTACLE_COLOUR, opacity=OBSTACLE_OPACITY)
    if isinstance(obstacle, BoxObstacle):
        solid(node, shapes.Box(obstacle.sides.tolist()), pin.SE3(obstacle.turn, obstacle.position))
        return np.asarray(_CORNERS * obstacle.sides / 2 @ obstacle.turn.T + obstacle.position)
    draw_capsule(node, obstacle.axis, obstacle.radius, solid)
    return np.concatenate([place + obstacle.radius * _CORNERS for place in obstacle.axis])


def _solid(node: Any, shape: Any, placement: pin.SE3, **material: Any) -> None:
    node.set_object(shape, shapes.MeshLambertMaterial(**material))
    node.set_transform(placement.homogeneous)


def draw_shapes(run: DrawnSolution, tracks: Animation) -> None:
    """Draw the links' collision shapes of the file, and move them with their joints."""
    bodies, model = run.solution.description.bodies, run.solution.model
    drawn = set()
    links = () if bodies is None else [s for s in bodies.shapes if s.name not in bodies.carried]
    for shape in links:
        frame = model.frames[model.getFrameId(shape.frame)]
        joint = int(frame.parentJoint)
        node = run.node["shapes"][f"joint{joint}"]
        if joint > 0 and joint not in drawn:
            tracks.place(node, run.motion.joints[:, joint])
        drawn.add(joint)
        part = node[shape.name.replace("/", "_")]
        part.set_transform(frame.placement.homogeneous)
        _draw_shape(part, shape, SHAPE_COLOUR, _unshadowed)


def _draw_shape(node: Any, shape: LinkShape, colour: int, solid: Solid) -> None:
    if len(shape.points) > 2:
        # A hull's radius is a fraction of a millimetre: moving its corners outwards shows it well enough.
        away = shape.points - shape.points.mean(axis=0)
        away /= np.linalg.norm(away, axis=1)[:, None]
        solid(node["solid"], _faces(shape.points + shape.radius * away, colour), pin.SE3.Identity())
    else:
        draw_capsule(node, shape.axis, shape.radius, solid)


def _unshadowed(node: Any, shape: Any, placement: pin.SE3) -> None:
    _solid(node, shape, placement, color=SHAPE_COLOUR, opacity=SHAPE_OPACITY, transparent=True)
    without_shadow(node)


def _faces(points: np.ndarray, colour: int) -> ColouredMeshGeometry:
    """Faces of the hull of points (n, 3) m, each with its own normal."""
    hull = convex_hull(thicken(points))
    corners, outward = hull.corners[hull.triangles], hull.normals
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside_out = np.sum(turned * outward, axis=1) < 0
    corners[inside_out] = corners[inside_out][:, ::-1]
    flat = corners.reshape(-1, 3)
    normals, triangles = np.repeat(outward, 3, axis=0), np.arange(len(flat)).reshape(-1, 3)
    return ColouredMeshGeometry.joined([(flat, normals, colour_array(colour), triangles)])


def draw_payloads(run: DrawnSolution, tracks: Animation) -> np.ndarray:
    """Animate payloads; returns points (k, 3) of their extent, m, world."""
    motion, places = run.motion, [np.zeros((0, 3))]
    for number, (payload, phases) in enumerate(_payloads(run.solution)):
        carried = np.isin(motion.phase, phases)
        if not carried.any():
            continue
        body, part = payload.spatial, run.node["payloads"][f"body{number}"]
        extent = _draw_payload(part["shape"], body, _shape_of(run.solution, payload))
        # It stays in place before it is picked up and after it is put down.
        contact = run.solution.contact_frames.index(payload.frame)
        hand = hold_while_hidden(motion.contacts[:, contact], carried)
        tracks.place(part, hand)
        centres = hand[:, :3, :3] @ body.lever + hand[:, :3, 3]
        places += [centres - extent, centres + extent]
    return np.concatenate(places)


def _payloads(solution: Solution) -> list[tuple[CarriedBody, list[int]]]:
    """Each carried body with its phases; the description lists a body once for each phase."""
    payloads: list[tuple[CarriedBody, list[int]]] = []
    for body in solution.description.payloads:
        for other, phases in payloads:
            if other.frame == body.frame and other.spatial == body.spatial:
                phases.extend(body.phases)
                break
        else:
            payloads.append((body, list(body.phases)))
    return payloads


def _shape_of(solution: Solution, payload: CarriedBody) -> LinkShape | None:
    """The shape of a payload in the file; None for a point mass and in older files."""
    bodies = solution.description.bodies
    for shape in () if bodies is None else bodies.shapes:
        carried = bodies.carried.get(shape.name) if bodies is not None else None
        if carried and shape.frame == payload.frame and set(payload.phases) <= set(carried.phases):
            return shape if shape.extent > LEAST_EXTENT else None
    return None


def _draw_payload(node: Any, body: pin.Inertia, shape: LinkShape | None) -> float:
    """Draw a shape, the box of the body's inertia, or a ball for a point mass; returns its reach in m."""
    if shape is not None:
        _draw_shape(node, shape, PAYLOAD_COLOUR, partial(_solid, color=PAYLOAD_COLOUR))
        return float(np.linalg.norm(shape.points - body.lever, axis=1).max()) + float(shape.radius)
    box = box_of_inertia(body)
    if box is not None:
        sides, placement = box
        _solid(node, shapes.Box(sides.tolist()), placement, color=PAYLOAD_COLOUR)
        return float(np.linalg.norm(sides)) / 2
    radius = float((3 * max(body.mass, 1e-6) / (4 * np.pi * DENSITY)) ** (1 / 3))
    _solid(node, shapes.Sphere(radius), pin.SE3(np.eye(3), body.lever), color=PAYLOAD_COLOUR)
    return radius
