"""Checks for joints that rule out any motion: limits of 0, and joints that move no inertia."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_JOINT, BASE_ROWS
from trajopt.dynamics.model_quantities import joints_of_rows
from trajopt.errors import InputError
from trajopt.robot.building import reach, reference_posture

if TYPE_CHECKING:
    from trajopt.robot.robot import Robot

Limit = Literal["velocity", "torque"]

# An inertia about a joint's axis below this fraction of (moved mass) x (reach of the robot)^2 counts as zero:
# ten million times less than that of a finger on a humanoid, but above rounding.
NO_INERTIA = 1e-13
# Step, rad or m, to a second posture: in the first one a mass may happen to lie on a joint's axis.
POSTURE_STEP = 0.3
REMEDIES = {
    "velocity": "the actuator's in <limit velocity=...>, or lock the joint",
    "torque": "the actuator's in <limit effort=...>, lock the joint, or state it as passive",
}


def require_moving(robot: Robot, *limits: Limit) -> None:
    """Raise `InputError` that names joints with a limit of 0: "velocity" or "torque", default both."""
    rows, owners = robot.actuated_rows, joints_of_rows(robot.model)
    for limit in limits or ("velocity", "torque"):
        values = robot.velocity_limit[rows] if limit == "velocity" else robot.torque_limit
        still = [] if values is None else [owners[row] for row in rows[values[: len(rows)] == 0]]
        if still:
            raise InputError(
                f"the {limit} limit of {_named(still, robot)} is 0", f"allowed: {REMEDIES[limit]}"
            )


@checked
def without_zero_limits(robot: Robot, reference: ArrayLike | Mapping[str, float] | None = None) -> Robot:
    """Return the robot without limits that are 0 where a file means none: exporters write zeros.

    These are velocity limits of 0, position limits that leave no range, and torque limits if all are 0. A
    ``reference`` as in `Robot.from_urdf` replaces the robot's.
    """
    rates, lower, upper = (
        np.array(each) for each in (robot.velocity_limit, robot.position_lower, robot.position_upper)
    )
    rates[rates == 0] = np.inf
    still = lower == upper
    lower[still], upper[still] = -np.inf, np.inf
    torque = robot.torque_limit
    weak = torque is not None and not torque.any()
    posture = reference_posture(robot.model, robot.base, robot.contacts, reference)
    return replace(
        robot,
        reference=robot.reference if reference is None else posture,
        velocity_limit=rates,
        position_lower=lower,
        position_upper=upper,
        torque_limit=None if weak else torque,
    )


def require_inertia(robot: Robot) -> None:
    """Raise `InputError` that names joints without inertia: torques do not determine their acceleration."""
    joints = joints_without_inertia(robot)
    if joints:
        raise InputError(
            f"no inertia is moved by {_named(joints, robot)}, so that torques do not determine how it moves",
            "allowed: lock it (locked=), give its link an <inertial>, or the joint an armature",
        )


def joints_without_inertia(robot: Robot) -> list[str]:
    """Joints behind the base that move no inertia in the reference posture and in one nearby."""
    beside = np.full(robot.nv, POSTURE_STEP)
    beside[: BASE_ROWS[robot.base]] = 0.0
    there = np.asarray(pin.integrate(robot.model, robot.reference, beside))
    return [
        joint for joint in _without_inertia(robot, robot.reference) if joint in _without_inertia(robot, there)
    ]


def _without_inertia(robot: Robot, q: np.ndarray) -> list[str]:
    """Joints whose block of the mass matrix is singular at ``q``."""
    model, data, found = robot.model, robot.model.createData(), []
    matrix, square = pin.crba(model, data, q), (reach(model) or 1.0) ** 2
    pin.computeSubtreeMasses(model, data)
    for joint in model.joints[BASE_JOINT[robot.base] + 1 :]:
        rows = slice(joint.idx_v, joint.idx_v + joint.nv)
        least = NO_INERTIA * data.mass[joint.id] * square
        if joint.nv and np.linalg.eigvalsh(matrix[rows, rows], UPLO="U")[0] <= least:
            found.append(str(model.names[joint.id]))
    return found


def _named(joints: list[str], robot: Robot) -> str:
    known = list(dict.fromkeys(joints))
    more = f" and {len(known) - 1} more" if len(known) > 1 else ""
    return f"joint '{known[0]}'{more} of '{robot.name}'"
