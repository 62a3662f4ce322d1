"""Torque limits of joints from the actuators of a compiled MJCF file."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.robot.mujoco_package import mujoco_package


@dataclass(frozen=True, kw_only=True)
class JointActuation:
    """Of each joint (njnt,): its torque limit, N m or N, inf without one, and whether it is ``driven``.

    armature: reflected inertia of its actuators, kg m^2 or kg. others: names of actuators that are none of a
    hinge's or slide's, or a muscle.
    """

    effort: np.ndarray
    armature: np.ndarray
    driven: np.ndarray
    others: tuple[str, ...]


def effort_limits(compiled: Any) -> JointActuation:
    """Limits by gear, force range and, of plain motors, gain and control range; several on a joint add.

    Of a range that is not symmetric the smaller side is the limit.
    """
    mujoco = mujoco_package()
    scalar = compiled.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    ranges, driven, others = np.zeros((compiled.njnt, 2)), np.zeros(compiled.njnt, dtype=bool), []
    armature, rotor = np.zeros(compiled.njnt), getattr(compiled, "actuator_armature", np.zeros(compiled.nu))
    outputs = getattr(compiled, "actuator_outadr", range(compiled.nu))  # MuJoCo 3 has one each
    for index in range(getattr(compiled, "nactuator", compiled.nu)):
        joint = int(compiled.actuator_trnid[index, 0])
        on_joint = compiled.actuator_trntype[index] <= int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        muscle = compiled.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_MUSCLE
        if not on_joint or muscle or not scalar[joint]:
            name = mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_ACTUATOR, index)
            others.append(name or f"actuator{index}")
            continue
        gear = float(compiled.actuator_gear[outputs[index], 0])
        ranges[joint] += _force_range(compiled, index, gear)
        armature[joint] += gear**2 * rotor[index]
        driven[joint] = True
    ranges[~driven] = -np.inf, np.inf
    clamped = compiled.jnt_actfrclimited.astype(bool)
    bounds = compiled.jnt_actfrcrange[clamped]
    ranges[clamped] = np.clip(ranges[clamped], bounds[:, :1], bounds[:, 1:])
    effort = np.abs(ranges).min(axis=1, initial=np.inf)
    return JointActuation(effort=effort, armature=armature, driven=driven, others=tuple(others))


def _force_range(compiled: Any, index: int, gear: float) -> np.ndarray:
    """Least and largest force (2,) of an actuator on its joint, N m or N."""
    mujoco = mujoco_package()
    limits = np.array([-np.inf, np.inf])
    if compiled.actuator_forcelimited[index]:
        limits = compiled.actuator_forcerange[index].copy()
    plain = compiled.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED
    plain = plain and compiled.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_NONE
    plain = plain and compiled.actuator_dyntype[index] != mujoco.mjtDyn.mjDYN_INTEGRATOR
    control = int(getattr(compiled, "actuator_ctrladr", range(compiled.nu))[index])
    if plain and compiled.actuator_ctrllimited[control]:
        driven = np.sort(compiled.actuator_gainprm[index, 0] * compiled.actuator_ctrlrange[control])
        limits = np.clip(driven, *limits)
    return np.sort(gear * limits) if gear else np.zeros(2)
