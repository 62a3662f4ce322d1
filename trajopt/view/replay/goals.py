"""Goals of a replay: those of the problem, and what a whole-body controller asked for in a simulation."""

from collections.abc import Sequence
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.motion.solution import Solution
from trajopt.schedule.moment import Target
from trajopt.terrain.surface import UP, Surface, frame_of_normal
from trajopt.view.replay.balance import THROUGH
from trajopt.view.replay.commands import Animation
from trajopt.view.replay.contacts import LEAST_FORCE, ArrowLook, draw_arrow
from trajopt.view.replay.parts import HIDDEN_OPACITY, bullseye, draw_showing_through, draw_unshadowed, placed
from trajopt.view.replay.robot import tip_frames
from trajopt.view.replay.runs import DrawnSolution

CROSS_COLOUR = 0xB8860B
AXIS_COLOURS = (0xC0392B, 0x2E8B57, 0x1F5FBF)
# Over the robot's extent: half a cross, an axis of a triad, its radius, a foothold's ring, its lift.
CROSS, AXIS, RADIUS, RING, LIFT = 0.05, 0.1, 0.004, 0.03, 0.0035
ASKED_COLOUR, MEASURED_COLOUR = 0x00A08A, 0x1A1F26
# A broad translucent arrow around that of the actual force, so that both are visible if they coincide.
BROAD, OPACITY = 2.2, 0.35
# Over the robot's extent: half a cross of the centre of mass and of a foot, radius of a bar, measured ball.
COM_CROSS, FOOT_CROSS, BAR, BALL = 0.05, 0.025, 0.003, 0.008


def draw_goals(run: DrawnSolution, drop: float, size: float) -> np.ndarray:
    """Draw the problem's goals; returns their positions (k, 3), m.

    ``drop`` is how far below the contacts the drawn ground lies, m. Raises `SolutionFileError`.
    """
    drawn: list[np.ndarray] = []
    for target in run.solution.description.goals:
        for placement, kind in _marks(run.solution, target):
            if not any(np.allclose(placement, other, atol=1e-9) for other in drawn):
                _draw(run.node["goals"][f"{kind}{len(drawn)}"], kind, placement, drop, size)
                drawn.append(placement)
    return np.reshape([placement[:3, 3] for placement in drawn], (-1, 3))


def _marks(solution: Solution, target: Target) -> list[tuple[np.ndarray, str]]:
    """Placements (4, 4) and kinds of mark for one target; none for frames that the model does not have."""
    model, position = solution.model, target.position
    if target.q is not None:
        return [(place, "pose") for place in _posture(model, target.q)]
    if target.frame is None or not model.existFrame(target.frame) or position is None:
        return []  # a rotation alone has no position
    if target.rotation is not None:
        return [(placed(position, target.rotation), "pose")]
    if _lands(solution, target):
        normal = _normal(solution, target, position)
        radius = solution.description.radii[solution.contact_frames.index(target.frame)]
        return [(placed(position - radius * normal, frame_of_normal(normal)), "foothold")]
    return [(placed(position), "place")]


def _lands(solution: Solution, target: Target) -> bool:
    """Whether the target is where a contact begins, not a waypoint of a frame that may touch."""
    named = target.at.phase in solution.phase_names and target.frame in solution.contact_frames
    if not named or target.at.fraction > 0:
        return False
    rows = solution.phase == solution.phase_names.index(target.at.phase)
    return bool(solution.active[rows, solution.contact_frames.index(target.frame)].any())


def _posture(model: pin.Model, q: np.ndarray) -> list[np.ndarray]:
    """Placement of the base at a configuration, or those of the tips for a fixed base."""
    if q.shape != (model.nq,):
        return []
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    base = BASE_JOINT[base_of(model)]
    if base:
        return [data.oMi[base].homogeneous]
    return [data.oMf[frame].homogeneous for frame in tip_frames(model)]


def _normal(solution: Solution, target: Target, position: np.ndarray) -> np.ndarray:
    """Normal under a contact that lands: of its own surface in that phase, or else of the terrain."""
    surfaces, terrain = solution.description.surfaces, solution.description.ground
    index = solution.phase_names.index(target.at.phase)
    surface = surfaces[index].get(str(target.frame)) if index < len(surfaces) else None
    if surface is not None:
        return surface.normal
    if terrain is None or isinstance(terrain, Surface):
        return np.array(UP) if terrain is None else terrain.normal
    return np.asarray(terrain.normal(position[:1], position[1:2])[0])


def _draw(node: Any, kind: str, placement: np.ndarray, drop: float, size: float) -> None:
    if kind == "foothold":
        lifted = placement.copy()
        lifted[:3, 3] += (LIFT * size - drop) * placement[:3, 2]
        material = shapes.MeshBasicMaterial(vertexColors=True)
        draw_unshadowed(node, bullseye(RING * size, CROSS_COLOUR), material)
        node.set_transform(lifted)
        return
    node.set_transform(placement)
    if kind == "pose":
        _draw_arms(node, AXIS * size, RADIUS * size, AXIS_COLOURS, 0.5, HIDDEN_OPACITY)
        draw_showing_through(node["centre"], shapes.Sphere(2 * RADIUS * size), color=CROSS_COLOUR)
    else:
        _draw_cross(node, CROSS * size, RADIUS * size, CROSS_COLOUR)


def _draw_cross(node: Any, half: float, radius: float, colour: int, through: float = HIDDEN_OPACITY) -> None:
    """Draw three crossed bars, ``half`` m to each side, with a ball in the middle."""
    _draw_arms(node, 2 * half, radius, (colour,) * 3, 0.0, through)
    draw_showing_through(node["centre"], shapes.Sphere(2 * radius), through=through, color=colour)


def _draw_arms(
    node: Any, length: float, radius: float, colours: Sequence[int], middle: float, through: float
) -> None:
    """Draw bars along x, y and z; ``middle`` is the position of their middles over their length."""
    for name, axis, colour in zip("xyz", np.eye(3), colours, strict=True):
        draw_showing_through(node[name], shapes.Cylinder(length, radius), through=through, color=colour)
        turn = pin.Quaternion.FromTwoVectors(np.eye(3)[1], axis).toRotationMatrix()
        node[name].set_transform(placed(middle * length * axis, turn))


def draw_controller(
    run: DrawnSolution, tracks: Animation, com: np.ndarray, size: float, weight_arrow: float
) -> None:
    """Animate the goals of a solution's controller, if it had one: contact forces, feet and centre of mass.

    Forces are arrows at the scale of `draw_arrows`. The desired centre of mass is a cross, the measured one,
    ``com`` (n, 3) m, a ball; a desired foot is a small cross where the foot would touch. ``size`` is the
    robot's extent, m.
    """
    solution, motion, node = run.solution, run.motion, run.node["controller"]
    if solution.asked_force is None or solution.com_goal is None or solution.foot_goal is None:
        return
    look = ArrowLook(size=size, scale=weight_arrow, colour=ASKED_COLOUR, broad=BROAD, opacity=OPACITY)
    wrench = motion.between(solution.asked_force)
    start, below = motion.pressed(wrench), solution.description.radii[:, None] * motion.touched.normal
    wanted_feet = motion.between(solution.foot_goal) - below
    for contact, frame in enumerate(solution.contact_frames):
        name, force = frame.replace("/", "_"), wrench[:, contact, :3] / motion.weight
        shown = np.linalg.norm(force, axis=1) > LEAST_FORCE
        draw_arrow(node["forces"][name], tracks, start[:, contact], force, shown, look)
        _mark(node["feet"][name], tracks, wanted_feet[:, contact], FOOT_CROSS * size, BAR * size)
    wanted = motion.between(solution.com_goal)
    if _mark(node["com"], tracks, wanted, COM_CROSS * size, BAR * size):
        ball = shapes.Sphere(BALL * size)
        draw_showing_through(node["measured"], ball, through=THROUGH, color=MEASURED_COLOUR)
        tracks.add(node["measured"], "position", com)
        tracks.add(node["measured"], "visible", np.isfinite(wanted).all(axis=1))


def _mark(node: Any, tracks: Animation, place: np.ndarray, half: float, radius: float) -> bool:
    """Animate a cross at places (n, 3), m, hidden where they are NaN; returns whether it is ever shown."""
    shown = np.isfinite(place).all(axis=1)
    if shown.any():
        _draw_cross(node, half, radius, ASKED_COLOUR, THROUGH)
        tracks.show(node, shown, position=place)
    return bool(shown.any())
