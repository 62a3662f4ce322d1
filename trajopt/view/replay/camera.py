"""Where the camera of Meshcat's own page stands; the player's cameras are in web/cameras.js."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.terrain.surface import Surface

# Vertical field of view in degrees: little perspective.
FIELD_OF_VIEW = 35.0
# Direction from the robot to the camera: from its right and ahead, slightly above.
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.42])


def initial_camera(vis: Any, box: np.ndarray, ground: Surface) -> None:
    """Frame the whole ``box`` (2, 3), m, and the ground below it.

    Meshcat's camera always looks at the origin of the viewer: the world is moved there instead.
    """
    middle = box.mean(axis=0)
    below = middle - ground.distance(middle) * ground.normal
    low, high = np.minimum(box[0], below), np.maximum(box[1], below)
    target = (low + high) / 2
    distance = float(np.linalg.norm(high - low)) / 2 / np.sin(np.radians(FIELD_OF_VIEW) / 2)
    offset = distance * CAMERA_DIRECTION / np.linalg.norm(CAMERA_DIRECTION)
    lens = vis["/Cameras/default/rotated/<object>"]
    lens.set_property("fov", FIELD_OF_VIEW)
    lens.set_property("position", [float(offset[0]), float(offset[2]), float(-offset[1])])  # y is up there
    vis.set_transform(pin.SE3(np.eye(3), -target).homogeneous)
