"""Torque limits, armatures and thrusters from the actuators of a compiled MJCF file."""

from typing import Any, NamedTuple

import numpy as np

from trajopt.robot.actuators.actuation import Thruster

# Values of MuJoCo's mjtJoint, mjtTrn (a joint in its own or its parent's axes), mjtGain, mjtBias and mjtDyn.
FREE, BALL, SLIDE, HINGE = range(4)
JOINT_TRANSMISSIONS = (0, 1)
SITE_TRANSMISSION = 4
PARALLEL_ERROR = 1e-9
FIXED_GAIN, AFFINE_GAIN, MUSCLE, NO_BIAS, INTEGRATOR = 0, 1, 2, 0, 1


class JointActuation(NamedTuple):
    """Per joint (njnt,): torque limit ``effort``, N m or N, inf without one; ``driven``: has an actuator.

    armature (njnt,): reflected inertia of the actuators, kg m^2 or kg. thrusters: actuators that push along
    an axis of a site. others: names of the rest, such as muscles, dampers and actuators of tendons.
    """

    effort: np.ndarray
    armature: np.ndarray
    driven: np.ndarray
    thrusters: tuple[Thruster, ...]
    others: tuple[str, ...]


def actuation_of(compiled: Any) -> JointActuation:
    """Actuation of joints from gear, force range and, for plain motors, gain and control range.

    Actuators of one joint add up. The limit is the smaller side of a range that is not symmetric.
    """
    count = getattr(compiled, "nactuator", compiled.nu)
    outputs = getattr(compiled, "actuator_outadr", np.arange(count))  # MuJoCo 3 has one each
    rotor = getattr(compiled, "actuator_armature", np.zeros(count))
    ranges, armature = np.zeros((compiled.njnt, 2)), np.zeros(compiled.njnt)
    driven, thrusters, others = np.zeros(compiled.njnt, dtype=bool), [], []
    for index in range(count):
        joint, gear = int(compiled.actuator_trnid[index, 0]), compiled.actuator_gear[outputs[index], 0]
        kind, gain = compiled.actuator_gaintype[index], compiled.actuator_gainprm[index]
        is_damper = kind == AFFINE_GAIN and not gain[:2].any()  # its force is a multiple of the rate alone
        on_joint = compiled.actuator_trntype[index] in JOINT_TRANSMISSIONS
        plain = on_joint and kind != MUSCLE and not is_damper
        if not plain or compiled.jnt_type[joint] not in (SLIDE, HINGE):
            name = compiled.actuator(index).name or f"actuator{index}"
            thruster = _thruster(compiled, index, name, compiled.actuator_gear[outputs[index]])
            others += [name] if thruster is None else []
            thrusters += [] if thruster is None else [thruster]
            continue
        driven[joint] = True
        armature[joint] += gear**2 * rotor[index]
        ranges[joint] += np.sort(gear * _force_range(compiled, index)) if gear else 0.0
    ranges[~driven] = -np.inf, np.inf
    clamped = compiled.jnt_actfrclimited.astype(bool)
    ranges[clamped] = np.clip(ranges[clamped], *compiled.jnt_actfrcrange[clamped].T[..., None])
    return JointActuation(
        np.abs(ranges).min(axis=1, initial=np.inf), armature, driven, tuple(thrusters), tuple(others)
    )


def _thruster(compiled: Any, index: int, name: str, gear: np.ndarray) -> Thruster | None:
    """Thruster of an actuator at a site that pushes one way with a moment about its axis alone, or None."""
    site, reference = (int(number) for number in compiled.actuator_trnid[index])
    size = float(np.linalg.norm(gear[:3]))
    if compiled.actuator_trntype[index] != SITE_TRANSMISSION or reference >= 0 or not size > 0:
        return None
    axis, (least, most) = gear[:3] / size, size * _force_range(compiled, index)
    drag = float(gear[3:] @ axis) / size
    if least < 0 or np.abs(gear[3:] - size * drag * axis).max() > PARALLEL_ERROR * size:
        return None
    frame = compiled.site(site).name
    return Thruster(name=name, frame=frame, axis=tuple(axis.tolist()), drag=drag, least=least, most=most)


def _force_range(compiled: Any, index: int) -> np.ndarray:
    """Least and largest force (2,) of an actuator, before its gear."""
    limits, control = np.array([-np.inf, np.inf]), getattr(compiled, "actuator_ctrladr", None)
    if compiled.actuator_forcelimited[index]:
        limits = compiled.actuator_forcerange[index]
    row = index if control is None else control[index]
    motor = compiled.actuator_gaintype[index] == FIXED_GAIN and compiled.actuator_biastype[index] == NO_BIAS
    if motor and compiled.actuator_dyntype[index] != INTEGRATOR and compiled.actuator_ctrllimited[row]:
        return np.clip(
            np.sort(compiled.actuator_gainprm[index, 0] * compiled.actuator_ctrlrange[row]), *limits
        )
    return np.asarray(limits)
