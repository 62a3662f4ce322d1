"""Drives assigned to the joints of a robot, and the resulting model and limits."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.errors import InputError, UnsupportedJointError
from trajopt.robot.actuators.drive import Drive

Drives = tuple[Drive | None, ...]


def drive_fields(
    model: pin.Model, rows: np.ndarray, effort: np.ndarray | None, velocity: np.ndarray, drives: Drives
) -> dict[str, Any]:
    """Return the fields of a robot that drives change: model, torque_limit, velocity_limit and drives.

    Args:
        model: model of the robot without drives; not changed.
        rows: row of v of each input (nu,), -1 for a thruster.
        effort: torque limits (nu,), N m or N, or None.
        velocity: velocity limits (nv,), rad/s or m/s.
        drives: a drive or None for each input (nu), see `Robot.with_drives`.
    """
    model = pin.Model(model)
    armature, gear, rotor = (
        np.array(array) for array in (model.armature, model.rotorGearRatio, model.rotorInertia)
    )
    effort = np.full(len(drives), np.inf) if effort is None else effort.copy()
    velocity = velocity.copy()
    for row, drive in enumerate(drives):
        if drive is None:
            continue
        index = rows[row]
        if drive.rotor_inertia > 0:
            armature[index], gear[index], rotor[index] = drive.armature, drive.gear_ratio, drive.rotor_inertia
        if np.isfinite(drive.torque_limit):
            effort[row] = drive.joint_torque_limit
        velocity[index] = min(velocity[index], drive.joint_no_load_speed)
    model.armature, model.rotorGearRatio, model.rotorInertia = armature, gear, rotor
    return {
        "model": model,
        "torque_limit": effort if np.isfinite(effort).any() else None,
        "velocity_limit": velocity,
        "drives": drives,
    }


def drives_by_row(
    robot: str,
    model: pin.Model,
    actuated: np.ndarray,
    present: Drives,
    given: Mapping[str, Drive | None] | Sequence[Drive | None],
) -> Drives:
    """Return a drive or None for each input (nu): a mapping changes named joints, a sequence replaces all.

    ``robot`` is the robot's name, ``actuated`` (nu,) the row of v of each input, and ``present`` (nu) its
    current drives. Raises `InputError`.
    """
    chosen: Drives = tuple(present)
    if not isinstance(given, Mapping):
        chosen = tuple(given)
    else:
        rows = list(present)
        for name, drive in given.items():
            rows[_row(robot, model, actuated, name)] = drive
        chosen = tuple(rows)
    require_drives(robot, model, actuated, chosen)
    return chosen


def _row(robot: str, model: pin.Model, actuated: np.ndarray, name: str) -> int:
    """Index among the actuated rows of the joint of that name."""
    known = [model.names[joint.id] for joint in list(model.joints)[1:] if joint.idx_v in actuated]
    if name not in known:
        raise InputError(f"robot '{robot}' has no actuated joint '{name}'", "one of " + ", ".join(known))
    joint = model.joints[model.getJointId(name)]
    if joint.nv != 1:
        raise UnsupportedJointError(name, joint.shortname(), "drives on joints of one degree of freedom")
    return int(np.flatnonzero(actuated == joint.idx_v)[0])


def require_drives(robot: str, model: pin.Model, actuated: np.ndarray, drives: Drives) -> None:
    """Raise `InputError` unless ``drives`` has a drive or None for each of the ``actuated`` rows (nu,)."""
    nu = len(actuated)
    foreign = [type(entry).__name__ for entry in drives if not (entry is None or isinstance(entry, Drive))]
    if foreign or len(drives) != nu:
        kinds = f", some of kind {', '.join(foreign)}" if foreign else ""
        raise InputError(
            f"drives of robot '{robot}' are {len(drives)}{kinds}",
            f"a Drive or None for each of its {nu} actuated rows",
        )
    single = {int(joint.idx_v) for joint in list(model.joints)[1:] if joint.nv == 1}
    for row, drive in enumerate(drives):
        if drive is not None and actuated[row] not in single:
            raise InputError(
                f"robot '{robot}' has a drive on row {row}, of a joint of several degrees of freedom",
                "allowed: drives on joints of one degree of freedom",
            )


def drive_torque(drives: Drives | None, torque: ca.SX, rates: ca.SX) -> ca.SX:
    """Torque (nu,) that the drives deliver, joint side: that of the actuated rows plus joint friction."""
    if drives is None or not any(_has_friction(drive) for drive in drives):
        return torque
    return torque + ca.vertcat(
        *[
            drive.friction_torque(rates[row]) if drive is not None and _has_friction(drive) else ca.SX(0)
            for row, drive in enumerate(drives)
        ]
    )


def drive_torque_values(drives: Drives, torque: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Numeric `drive_torque` of samples: torques (K, nu) and rates (K, nu) of the actuated rows."""
    friction = [
        np.zeros(len(rates)) if drive is None else drive.friction_torque(rates[:, row])
        for row, drive in enumerate(drives)
    ]
    return torque + np.array(friction).T.reshape(torque.shape)


def actuated_row_limit(
    drives: Drives | None, effort: np.ndarray | None, rates: np.ndarray
) -> np.ndarray | None:
    """Bound (nu,) on the actuated rows, N m, that follows from a torque limit (nu,) of the drives.

    Friction helps a drive to brake. An actuated row may therefore exceed the drive's torque by the friction
    at the joint's velocity limit, ``rates`` (nu,) rad/s.
    """
    if effort is None or drives is None:
        return effort
    widened = np.array(effort, dtype=float)
    for row, drive in enumerate(drives):
        if drive is not None:
            viscous = drive.viscous_friction * rates[row] if drive.viscous_friction > 0 else 0.0
            widened[row] += viscous + drive.coulomb_friction
    return widened


def _has_friction(drive: Drive | None) -> bool:
    return drive is not None and (drive.viscous_friction > 0 or drive.coulomb_friction > 0)
