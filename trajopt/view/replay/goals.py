"""Goals of a replay: footholds as rings, targets of frames as crosses or triads, of postures as triads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.schedule.targets import Target
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import UP, Surface, frame_of_normal
from trajopt.view.replay.parts import (
    HIDDEN_OPACITY,
    bullseye,
    draw_showing_through,
    draw_unshadowed,
    placed,
)
from trajopt.view.replay.robot import tip_frames
from trajopt.view.replay.runs import DrawnSolution

CROSS_COLOUR = 0xB8860B
AXIS_COLOURS = (0xC0392B, 0x2E8B57, 0x1F5FBF)
# Over the robot's extent: half a cross, an axis of a triad, its radius, a foothold's ring, its lift.
CROSS, AXIS, RADIUS, RING, LIFT = 0.05, 0.1, 0.004, 0.03, 0.0035


def draw_goals(run: DrawnSolution, drop: float, size: float) -> np.ndarray:
    """Draw the problem's goals ; returns their positions (k, 3), m.

    drop: how far below the contacts the drawn ground lies, m. Raises `SolutionFileError`.
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
    model = solution.model
    if target.q is not None:
        return [(place, "pose") for place in _posture(model, target.q)]
    if target.frame is None or not model.existFrame(target.frame) or target.position is None:
        return []  # a rotation alone has no position
    if target.rotation is not None:
        return [(placed(target.position, target.rotation), "pose")]
    if _lands(solution, target):
        normal = _normal(solution, target)
        radius = solution.description.radii[solution.contact_frames.index(target.frame)]
        return [(placed(target.position - radius * normal, frame_of_normal(normal)), "foothold")]
    return [(placed(target.position), "place")]


def _lands(solution: Solution, target: Target) -> bool:
    """Whether the target is where a contact begins, not a waypoint of a frame that may touch."""
    index = _phase_index(solution, target)
    if index is None or target.at.fraction > 0 or target.frame not in solution.contact_frames:
        return False
    rows = solution.phase == index
    return bool(solution.active[rows, solution.contact_frames.index(target.frame)].any())


def _phase_index(solution: Solution, target: Target) -> int | None:
    names = solution.phase_names
    return names.index(target.at.phase) if target.at.phase in names else None


def _posture(model: pin.Model, q: np.ndarray) -> list[np.ndarray]:
    """Position of the base at a configuration, or for a fixed base of the tips."""
    if q.shape != (model.nq,):
        return []
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    base = BASE_JOINT[base_of(model)]
    if base:
        return [data.oMi[base].homogeneous]
    return [data.oMf[frame].homogeneous for frame in tip_frames(model)]


def _normal(solution: Solution, target: Target) -> np.ndarray:
    """Normal under a contact that lands: of its own surface in that phase, else of the terrain."""
    index, position = _phase_index(solution, target), target.position
    surfaces = solution.description.surfaces
    if index is not None and index < len(surfaces):
        surface = surfaces[index].get(str(target.frame))
        if surface is not None:
            return surface.normal
    terrain = solution.description.ground
    if terrain is None or position is None:
        return np.array(UP)
    if isinstance(terrain, Surface):
        return terrain.normal
    return np.asarray(terrain.normal(position[:1], position[1:2])[0])


def _draw(node: Any, kind: str, placement: np.ndarray, drop: float, size: float) -> None:
    if kind == "foothold":
        lifted = placement.copy()
        lifted[:3, 3] += (LIFT * size - drop) * placement[:3, 2]
        draw_unshadowed(
            node, bullseye(RING * size, CROSS_COLOUR), shapes.MeshBasicMaterial(vertexColors=True)
        )
        node.set_transform(lifted)
        return
    node.set_transform(placement)
    if kind == "pose":
        _draw_arms(node, AXIS * size, RADIUS * size, AXIS_COLOURS, 0.5, HIDDEN_OPACITY)
        draw_showing_through(node["centre"], shapes.Sphere(2 * RADIUS * size), color=CROSS_COLOUR)
    else:
        draw_cross(node, CROSS * size, RADIUS * size, CROSS_COLOUR)


def draw_cross(node: Any, half: float, radius: float, colour: int, through: float = HIDDEN_OPACITY) -> None:
    """Draw three bars across each other, ``half`` m to each side, with a ball in the middle.

    through: opacity where it is covered.
    """
    _draw_arms(node, 2 * half, radius, (colour,) * 3, 0.0, through)
    draw_showing_through(node["centre"], shapes.Sphere(2 * radius), through=through, color=colour)


def _draw_arms(
    node: Any, length: float, radius: float, colours: Sequence[int], middle: float, through: float
) -> None:
    """Bars along x, y and z; ``middle``: of a bar along its axis, over its length."""
    for axis in range(3):
        arm = node["xyz"[axis]]
        draw_showing_through(arm, shapes.Cylinder(length, radius), through=through, color=colours[axis])
        turn = pin.Quaternion.FromTwoVectors(np.eye(3)[1], np.eye(3)[axis]).toRotationMatrix()
        arm.set_transform(placed(middle * length * np.eye(3)[axis], turn))
