"""Drives on a robot: which joint has which, and what they make of its model and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.actuators.drive import Drive
from trajopt.errors import InputError, UnsupportedJointError

if TYPE_CHECKING:
    from trajopt.robot import Robot

Drives = tuple[Drive | None, ...]


def driven(robot: Robot, drives: Mapping[str, Drive | None] | Sequence[Drive | None]) -> Robot:
    """Return ``robot`` with drives, by joint name or one (or None) for each actuated row (nu).

    A mapping changes the joints it names; a sequence states all. See `Robot.with_drives`.
    """
    chosen = _by_row(robot, drives)
    require_drives(robot, chosen)
    model = pin.Model(robot.model)
    armature, gear, rotor = (
        np.array(array) for array in (model.armature, model.rotorGearRatio, model.rotorInertia)
    )
    effort = np.full(robot.nu, np.inf) if robot.effort_limit is None else robot.effort_limit.copy()
    velocity = robot.velocity_limit.copy()
    for row, drive in enumerate(chosen):
        if drive is None:
            continue
        index = robot.n_unactuated + row
        if drive.rotor_inertia > 0:
            armature[index], gear[index], rotor[index] = drive.armature, drive.gear_ratio, drive.rotor_inertia
        if np.isfinite(drive.torque_limit):
            effort[row] = drive.joint_torque_limit
        velocity[index] = min(velocity[index], drive.joint_no_load_speed)
    model.armature, model.rotorGearRatio, model.rotorInertia = armature, gear, rotor
    return replace(
        robot,
        model=model,
        effort_limit=effort if np.isfinite(effort).any() else None,
        velocity_limit=velocity,
        drives=chosen,
    )


def _by_row(robot: Robot, drives: Mapping[str, Drive | None] | Sequence[Drive | None]) -> Drives:
    if not isinstance(drives, Mapping):
        return tuple(drives)
    chosen = list(robot.drives or (None,) * robot.nu)
    for name, drive in drives.items():
        chosen[_row(robot, name)] = drive
    return tuple(chosen)


def _row(robot: Robot, name: str) -> int:
    """Actuated row of the joint of that name."""
    known = [
        robot.model.names[joint.id]
        for joint in list(robot.model.joints)[1:]
        if joint.idx_v >= robot.n_unactuated
    ]
    if name not in known:
        raise InputError(f"robot '{robot.name}' has no actuated joint '{name}'", "one of " + ", ".join(known))
    joint = robot.model.joints[robot.model.getJointId(name)]
    if joint.nv != 1:
        raise UnsupportedJointError(name, joint.shortname(), "drives on joints of one degree of freedom")
    return int(joint.idx_v) - robot.n_unactuated


def require_drives(robot: Robot, drives: Drives) -> None:
    """Raise `InputError` unless ``drives`` are one or None for each actuated row, of single joints."""
    foreign = [type(entry).__name__ for entry in drives if not (entry is None or isinstance(entry, Drive))]
    if foreign or len(drives) != robot.nu:
        kinds = f", some of kind {', '.join(foreign)}" if foreign else ""
        raise InputError(
            f"drives of robot '{robot.name}' are {len(drives)}{kinds}",
            f"a Drive or None for each of its {robot.nu} actuated rows",
        )
    single = {int(joint.idx_v) for joint in list(robot.model.joints)[1:] if joint.nv == 1}
    for row, drive in enumerate(drives):
        if drive is not None and row + robot.n_unactuated not in single:
            raise InputError(
                f"robot '{robot.name}' has a drive on row {row}, of a joint of several degrees of freedom",
                "allowed: drives on joints of one degree of freedom",
            )


def drive_torque(drives: Drives | None, torque: ca.SX, rates: ca.SX) -> ca.SX:
    """Torque (nu,) that the drives deliver, joint side: actuated rows plus joint friction."""
    if drives is None or not any(_has_friction(drive) for drive in drives):
        return torque
    return torque + ca.vertcat(
        *[
            drive.friction_torque(rates[row]) if drive is not None and _has_friction(drive) else ca.SX(0)
            for row, drive in enumerate(drives)
        ]
    )


def drive_torque_values(drives: Drives, torque: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """The same of samples: torque (K, nu), rates of the actuated rows (K, nu)."""
    friction = [
        np.zeros(len(rates)) if drive is None else drive.friction_torque(rates[:, row])
        for row, drive in enumerate(drives)
    ]
    return torque + np.array(friction).T.reshape(torque.shape)


def actuated_row_limit(robot: Robot, effort: np.ndarray | None) -> np.ndarray | None:
    """Bound (nu,) on the actuated rows that follows from an effort limit (nu,) of the drives, N m.

    Friction helps a drive to brake: actuated rows may exceed what it delivers by the friction at the
    joint's velocity limit.
    """
    if effort is None or robot.drives is None:
        return effort
    rates = robot.velocity_limit[robot.n_unactuated :]
    widened = np.array(effort, dtype=float)
    for row, drive in enumerate(robot.drives):
        if drive is not None:
            viscous = drive.viscous_friction * rates[row] if drive.viscous_friction > 0 else 0.0
            widened[row] += viscous + drive.coulomb_friction
    return widened


def _has_friction(drive: Drive | None) -> bool:
    return drive is not None and (drive.viscous_friction > 0 or drive.coulomb_friction > 0)
