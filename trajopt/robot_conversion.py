"""Robots made of robots: with joints locked, or on another base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from trajopt.bases.virtual_base import from_free_flyer, virtual_model
from trajopt.errors import InputError
from trajopt.robot_building import locked_model

if TYPE_CHECKING:
    from trajopt.robot import Robot


def lock(robot: Robot, joints: Sequence[str], reference: np.ndarray) -> Robot:
    """Return ``robot`` with ``joints`` welded at ``reference`` (nq,); limits of the others are kept."""
    replace(robot, reference=reference)  # refuses a reference of wrong shape or outside the limits
    model = locked_model(robot.model, joints, reference)
    kept = [robot.model.joints[robot.model.getJointId(name)] for name in list(model.names)[1:]]
    rows_q = np.concatenate([np.arange(joint.idx_q, joint.idx_q + joint.nq) for joint in kept]).astype(int)
    rows_v = np.concatenate([np.arange(joint.idx_v, joint.idx_v + joint.nv) for joint in kept]).astype(int)
    actuated = rows_v[rows_v >= robot.n_unactuated] - robot.n_unactuated
    return replace(
        robot,
        model=model,
        reference=reference[rows_q],
        velocity_limit=robot.velocity_limit[rows_v],
        position_lower=robot.position_lower[rows_q],
        position_upper=robot.position_upper[rows_q],
        effort_limit=None if robot.effort_limit is None else robot.effort_limit[actuated],
        passive=tuple(name for name in robot.passive if name not in joints),
        drives=None if robot.drives is None else tuple(robot.drives[int(row)] for row in actuated),
    )


def on_virtual_base(robot: Robot, order: str) -> Robot:
    """Return a free-flyer ``robot`` on six virtual joints; see `Robot.with_virtual_base`."""
    if robot.base != "freeflyer":
        raise InputError(f"robot '{robot.name}' has base={robot.base!r}", "'freeflyer'")
    still = np.zeros(robot.nv)
    lower, upper = (array[7:] for array in (robot.position_lower, robot.position_upper))
    return replace(
        robot,
        model=virtual_model(robot.model, order),
        base="virtual",
        reference=from_free_flyer(order, robot.reference, still, still)[0],
        position_lower=np.concatenate([np.full(6, -np.inf), lower]),
        position_upper=np.concatenate([np.full(6, np.inf), upper]),
    )
