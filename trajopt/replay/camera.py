"""Where the camera of a replay stands at first, and how it travels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.replay.commands import Tracks
from trajopt.surface import Surface

# Vertical field of view in degrees: little perspective.
FIELD_OF_VIEW = 35.0
# Direction from the robot to the camera: from its right and ahead, slightly above.
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.42])


def initial_camera(
    vis: Any, tracks: Tracks, base: np.ndarray, box: np.ndarray, ground: Surface, size: float, travels: bool
) -> None:
    """Frame the whole ``box`` (2, 3); if the motion ``travels``, go along the ground with ``base`` (n, 3), m.

    Meshcat's camera always looks at the origin of the viewer: the world is moved there instead.
    """
    middle = box.mean(axis=0)
    below = middle - ground.distance(middle) * ground.normal
    low, high = np.minimum(box[0], below), np.maximum(box[1], below)
    if travels:
        low, high = base[0] - 0.75 * size, base[0] + 0.75 * size
    target = (low + high) / 2
    distance = float(np.linalg.norm(high - low)) / 2 / np.sin(np.radians(FIELD_OF_VIEW) / 2)
    offset = distance * CAMERA_DIRECTION / np.linalg.norm(CAMERA_DIRECTION)
    lens = vis["/Cameras/default/rotated/<object>"]
    lens.set_property("fov", FIELD_OF_VIEW)
    lens.set_property("position", [float(offset[0]), float(offset[2]), float(-offset[1])])  # y is up there
    vis.set_transform(pin.SE3(np.eye(3), -target).homogeneous)
    if travels:
        travel = (base - base[0]) @ ground.tangents.T
        tracks.add(vis, "position", "vector3", -target - travel @ ground.tangents)
