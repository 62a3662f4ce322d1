"""Distances of the one link that a goal places, before it is known where the others are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.collision.near import CollisionScene, ShapePair
from trajopt.collision.shapes import LinkShape
from trajopt.schedule.targets import Target
from trajopt.terrain.smooth import SmoothTerrain

# A ball of this radius, m, stands for the origin of a frame.
POINT = 1e-4
POINT_NAME = "origin of the frame"


def placed_link(scene: CollisionScene, target: Target) -> dict[ShapePair, float]:
    """Signed distances in m of the link that carries a target's frame from ground and obstacles, by pair.

    Where the target leaves its rotation free they are upper bounds for all rotations. With ``d`` the distance
    of the frame's origin from a shape of its link, negative inside, and ``e`` that of the target from another
    body, the shape has a point within ``d`` of the target, or all points within ``-d``: so its distance from
    the body is at most ``d + e``. Smooth ground, whose distances are those from tangent planes, is left out
    then.

    Args:
        scene: of a problem.
        target: position of a frame, or its pose.
    """
    if target.frame is None or target.position is None:
        return {}
    frames = {frame.name: frame for frame in scene.model.frames}
    carrier = frames[target.frame]
    shapes = tuple(s for s in scene.moving if frames[s.frame].parentJoint == carrier.parentJoint)
    if not shapes:
        return {}
    link = pin.Model()
    joint = link.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "link")
    for name in {target.frame, *(shape.frame for shape in shapes)}:
        link.addFrame(pin.Frame(name, joint, frames[name].placement, pin.FrameType.OP_FRAME))
    rotation = np.eye(3) if target.rotation is None else target.rotation
    q = pin.SE3ToXYZQUAT(pin.SE3(rotation, target.position) * carrier.placement.inverse())
    if target.rotation is not None:
        alone = CollisionScene(model=link, shapes=shapes, obstacles=scene.obstacles, terrain=scene.terrain)
        return dict(zip(alone.pairs, alone.distances(q)[0].tolist(), strict=True))
    origin = LinkShape.sphere(POINT_NAME, target.frame, np.zeros(3), POINT)
    alone = CollisionScene(
        model=link,
        shapes=(*shapes, origin),
        obstacles=scene.obstacles,
        self_pairs=tuple((shape.name, POINT_NAME) for shape in shapes),
        terrain=None if isinstance(scene.terrain, SmoothTerrain) else scene.terrain,
    )
    found = dict(zip(alone.pairs, (alone.distances(q)[0] + POINT).tolist(), strict=True))
    return {
        (shape, other): found[shape, POINT_NAME] + found[POINT_NAME, other]
        for shape, other in alone.pairs[: alone.n_outer]
        if shape != POINT_NAME
    }
