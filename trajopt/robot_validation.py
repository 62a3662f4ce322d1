"""What a robot must be: contacts that exist, limits that are not empty, a reference within them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from trajopt.bases.virtual_base import LEAST_MARGIN, gimbal_margin
from trajopt.contact import require_frame
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.robot import Robot

# A reference posture may touch its limit: rounding of degrees in description files, rad or m.
LIMIT_SLACK = 1e-6
# A unit quaternion or (cos, sin) pair of a reference is given with this many digits at least.
UNIT_SLACK = 1e-6


def require_contacts(robot: Robot) -> None:
    """Raise `InputError` for two contacts of one name, or one at a frame that does not exist."""
    names = [contact.name for contact in robot.contacts]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"robot '{robot.name}' has two contacts named '{name}'", "different names")
    for contact in robot.contacts:
        require_frame(robot.model, contact.frame, f"contact '{contact.name}'")


def require_limits(robot: Robot) -> None:
    """Raise `InputError` for limits that are empty, negative or NaN, or a length that is not positive."""
    length = robot.given_length
    if length is not None and not (np.isfinite(length) and length > 0):
        raise InputError(f"given_length of robot '{robot.name}' is {length}", "> 0 m, or None")
    if np.isnan(robot.position_lower).any() or np.isnan(robot.position_upper).any():
        raise InputError(f"position limits of robot '{robot.name}' hold NaN", "numbers, or -inf and inf")
    for index in np.flatnonzero(robot.position_lower > robot.position_upper):
        raise InputError(
            f"position limits of robot '{robot.name}' are empty at index {index}: "
            f"{robot.position_lower[index]} > {robot.position_upper[index]}",
            "lower <= upper",
        )
    for field in ("velocity_limit", "effort_limit"):
        limit = getattr(robot, field)
        if limit is not None and not (limit >= 0).all():
            raise InputError(f"{field} of robot '{robot.name}' is negative or NaN", "numbers >= 0, or inf")


def require_reference(robot: Robot) -> None:
    """Raise `InputError` for a reference not finite, outside the limits, not unit, or in gimbal lock."""
    q = robot.reference
    if not np.isfinite(q).all():
        raise InputError(f"reference of robot '{robot.name}' is not finite", "metres and radians")
    outside = np.maximum(robot.position_lower - q, q - robot.position_upper)
    for joint in list(robot.model.joints)[1:]:
        name, rows = robot.model.names[joint.id], slice(joint.idx_q, joint.idx_q + joint.nq)
        if (outside[rows] > LIMIT_SLACK).any():
            raise InputError(
                f"reference of robot '{robot.name}' is outside its limits at joint '{name}': {q[rows]}",
                f"{robot.position_lower[rows]} to {robot.position_upper[rows]}",
            )
    if not pin.isNormalized(robot.model, q, UNIT_SLACK):
        raise InputError(
            f"reference of robot '{robot.name}' has a quaternion or (cos, sin) pair that is not unit",
            "norm 1",
        )
    margin = gimbal_margin(robot.model, q)
    if margin is not None and margin < LEAST_MARGIN:
        raise InputError(
            f"reference of robot '{robot.name}' is in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )
