"""Validation of robots: contacts must exist, limits must not be empty, the reference must be within them."""

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import joints_of_rows, mass_of
from trajopt.dynamics.virtual_base import LEAST_MARGIN, gimbal_margin
from trajopt.errors import InputError
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.contact import Contact, require_frame

# A reference posture may exceed its limits by this, rad or m: rounding of degrees in description files.
LIMIT_SLACK = 1e-6
# Eigenvalues of an inertia may be negative by the first fraction of its largest, rounding in description
# files, or by the second fraction of the robot's largest: welded bodies are added up in other axes.
INERTIA_SLACK, WELDED_SLACK = 1e-6, 1e-15
# A larger angle in a reference may be in degrees, rad.
TURN = 2 * np.pi
# Norms of the quaternions and (cos, sin) pairs of a reference may differ from 1 by this.
UNIT_SLACK = 1e-6
# Joints whose coordinate is a length.
STRAIGHT = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismatic", "JointModelTranslation")


def require_contacts(robot: str, model: pin.Model, contacts: Sequence[Contact]) -> None:
    """Raise `InputError` for two contacts with the same name, or one at a frame that does not exist."""
    names = [contact.name for contact in contacts]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"robot '{robot}' has two contacts named '{name}'", "different names")
    for contact in contacts:
        require_frame(model, contact.frame, f"contact '{contact.name}'")


def require_thrusters(robot: str, model: pin.Model, thrusters: Sequence[Thruster]) -> None:
    """Raise `InputError` for a thruster that is not on the base or has the name of another input."""
    names = [*model.names, *(thruster.name for thruster in thrusters)]
    for thruster in thrusters:
        thruster.column(model)
        if names.count(thruster.name) > 1:
            raise InputError(f"robot '{robot}' has two inputs named '{thruster.name}'", "different names")


def require_inertias(robot: str, model: pin.Model) -> None:
    """Raise `InputError` for an unphysical mass, inertia, armature or gravity, or a robot without mass.

    Single links without mass or inertia are allowed: inverse dynamics does not invert the mass matrix.
    """
    moments = [np.abs(inertia.inertia).max() for inertia in list(model.inertias)[1:]]
    rounding = WELDED_SLACK * np.nan_to_num(moments, posinf=0.0).max(initial=0.0)
    for joint in range(1, model.njoints):
        inertia, where = model.inertias[joint], f"moved by joint '{model.names[joint]}' of '{robot}'"
        if not (np.isfinite(inertia.mass) and inertia.mass >= 0 and np.isfinite(inertia.lever).all()):
            raise InputError(
                f"the mass {where} is {inertia.mass:g} kg", "allowed: finite and >= 0, at a place"
            )
        if not np.isfinite(inertia.inertia).all():
            raise InputError(f"the inertia of the body {where} is not finite", "allowed: finite, kg m^2")
        principal = np.linalg.eigvalsh(inertia.inertia)
        if principal[0] < -max(INERTIA_SLACK * np.abs(principal).max(), rounding):
            raise InputError(
                f"the least principal inertia of the body {where} is {principal[0]:g} kg m^2", "allowed: >= 0"
            )
    if not (np.isfinite(model.armature).all() and (model.armature >= 0).all()):
        raise InputError(f"armature of robot '{robot}' is negative or not finite", "allowed: >= 0")
    if not np.isfinite(model.gravity.vector).all():
        raise InputError(f"gravity of robot '{robot}' is {model.gravity.linear}", "allowed: finite, m/s^2")
    if not mass_of(model) > 0:
        raise InputError(
            f"robot '{robot}' has no mass", "allowed: a link with mass (<inertial> in a URDF file)"
        )


def require_limits(
    robot: str,
    model: pin.Model,
    position: tuple[np.ndarray, np.ndarray],
    others: Mapping[str, tuple[Sequence[int] | np.ndarray, np.ndarray | None]],
) -> None:
    """Raise `InputError` for limits that are empty, negative or NaN.

    ``others`` holds further limits by name, each as the rows of v and the limits of these rows.
    """
    joints = list(model.joints)[1:]
    entries = [joint for joint in joints for _ in range(joint.nq)]
    for joint, lower, upper in zip(entries, *position, strict=True):
        if not lower <= upper:
            fault = "empty" if lower > upper else "not numbers"
            unit = "m" if joint.shortname().startswith(STRAIGHT) else "rad"
            what = f"position limits of joint '{model.names[joint.id]}' of '{robot}' are {fault}"
            raise InputError(f"{what}: {lower:g} > {upper:g} {unit}", "lower <= upper, or -inf and inf")
    owners = joints_of_rows(model)
    for field, (rows, limits) in others.items():
        for row, limit in zip(rows, [] if limits is None else limits, strict=limits is not None):
            if not limit >= 0:
                what = f"{field} of joint '{owners[row]}' of '{robot}' is {limit:g}"
                raise InputError(f"{what}: negative or NaN", "numbers >= 0, or inf")


def require_reference(
    robot: str, model: pin.Model, q: np.ndarray, position: tuple[np.ndarray, np.ndarray]
) -> None:
    """Raise `InputError` for a reference not finite, outside limits, not normalised or in gimbal lock."""
    lower, upper = position
    require_configuration(model, q, f"reference of robot '{robot}'")
    outside = np.maximum(lower - q, q - upper)
    for joint in list(model.joints)[1:]:
        name, rows = model.names[joint.id], slice(joint.idx_q, joint.idx_q + joint.nq)
        turns = joint.shortname().startswith("JointModelR") and joint.nq == 1 and abs(q[joint.idx_q]) > TURN
        hint = f"; if {q[joint.idx_q]:g} is in degrees, {np.radians(q[joint.idx_q]):.4g} rad" if turns else ""
        if (outside[rows] > LIMIT_SLACK).any():
            raise InputError(
                f"reference of robot '{robot}' is outside its limits at joint '{name}': {q[rows]}",
                f"{lower[rows]} to {upper[rows]}{hint}",
            )
        if hint:
            text = f"reference of robot '{robot}' has more than a turn at joint '{name}'{hint}"
            warnings.warn(text, UserWarning, stacklevel=2)
    margin = gimbal_margin(model, q)
    if margin is not None and margin < LEAST_MARGIN:
        raise InputError(
            f"reference of robot '{robot}' is in gimbal lock: margin {margin:.3f} < {LEAST_MARGIN}",
            "another order of the virtual joints, or base='freeflyer'",
        )


def require_configuration(model: pin.Model, q: np.ndarray, what: str) -> None:
    """Raise `InputError` for a configuration of wrong shape, not finite or with rotations not normalised."""
    if q.shape != (model.nq,):
        raise InputError(f"{what} is of shape {q.shape}", f"allowed: ({model.nq},), finite")
    for row in np.flatnonzero(~np.isfinite(q))[:1]:
        raise InputError(f"{what} is not finite: {q[row]} at row {row}", f"allowed: ({model.nq},), finite")
    if not pin.isNormalized(model, q, UNIT_SLACK):
        raise InputError(f"{what} has a quaternion or (cos, sin) pair that is not unit", "allowed: norm 1")
