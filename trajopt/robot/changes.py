"""Fields of a robot that change with thrusters, series springs or mimic joints.

The argument `robot` is a `Robot`; its methods call these functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import position_limits
from trajopt.errors import InputError
from trajopt.robot import building
from trajopt.robot.actuators.actuation import Thruster
from trajopt.robot.actuators.joint_force import SPRING, JointForce, with_spring_joints
from trajopt.robot.actuators.mimic import MimicJoint, followed, require_mimics

Fields = dict[str, Any]


def thrusters(robot: Any, given: Sequence[Thruster]) -> Fields:
    """Fields with these thrusters in place of the robot's own."""
    joints = len(robot.actuated_rows)
    limit = np.full(joints, np.inf) if robot.torque_limit is None else robot.torque_limit[:joints]
    limit = np.append(limit, [thruster.most for thruster in given])
    return {
        "thrusters": tuple(given),
        "torque_limit": limit if np.isfinite(limit).any() else None,
        "drives": None if robot.drives is None else (*robot.drives[:joints], *[None] * len(given)),
    }


def series_springs(robot: Any, stiffness: Mapping[str, float]) -> Fields:
    """Fields with springs between the gear and the link of joints. Raises `InputError`."""
    known = list(robot.model.names)[1:]
    for name in stiffness:
        if name not in known:
            raise InputError(f"joint '{name}' of a series spring is unknown", "one of " + ", ".join(known))
        if not 0 < stiffness[name] < math.inf:
            what = f"stiffness of the series spring of joint '{name}' is {stiffness[name]}"
            raise InputError(what, "above 0, N m/rad or N/m")
    model = with_spring_joints(robot.model, list(stiffness))
    q, v = building.joint_entries(model, known)
    changed = {"reference": pin.neutral(model), "velocity_limit": np.full(model.nv, np.inf)}
    changed["position_lower"], changed["position_upper"] = position_limits(model)
    for name, entries in (
        ("velocity_limit", v),
        ("reference", q),
        ("position_lower", q),
        ("position_upper", q),
    ):
        changed[name][entries] = getattr(robot, name)
    springs = [JointForce(joint=name + SPRING, stiffness=k) for name, k in stiffness.items()]
    return {
        "model": model,
        "passive": (*robot.passive, *(spring.joint for spring in springs)),
        "joint_forces": (*robot.joint_forces, *springs),
        "given_length": robot.length,
        **changed,
    }


def mimics(robot: Any, given: Sequence[MimicJoint], driven: Sequence[str]) -> Fields:
    """Fields with these mimic joints in place of the robot's own. Raises `InputError`."""
    model = robot.model
    require_mimics(robot.name, model, given)
    followers = [mimic.joint for mimic in given]
    for name in driven:
        if name not in followers or name in robot.passive:
            what = "is passive" if name in followers else "follows no other"
            raise InputError(f"driven joint '{name}' {what}", "joints that follow others and have a motor")
    idle = [name for name in followers if name not in driven]
    passive = tuple(dict.fromkeys((*robot.passive, *idle)))
    kept = np.flatnonzero(~np.isin(robot.rows_of_inputs, building.joint_entries(model, passive)[1]))
    names = ("position_lower", "position_upper", "velocity_limit")
    lower, upper, fastest = (getattr(robot, name).copy() for name in names)
    for mimic in given:  # the follower's limits also limit the leader
        (one, two), ratio = mimic.joints(model), mimic.ratio
        ends = (np.array([lower[one.idx_q], upper[one.idx_q]]) - mimic.offset) / (ratio or np.nan)
        lower[two.idx_q] = np.nanmax([lower[two.idx_q], np.min(ends)])
        upper[two.idx_q] = np.nanmin([upper[two.idx_q], np.max(ends)])
        fastest[two.idx_v] = np.nanmin([fastest[two.idx_v], fastest[one.idx_v] / (abs(ratio) or np.nan)])
    return {
        "mimics": tuple(given),
        "passive": passive,
        "reference": followed(model, given, np.clip(robot.reference, lower, upper)),
        "torque_limit": None if robot.torque_limit is None else robot.torque_limit[kept],
        "drives": None if robot.drives is None else tuple(robot.drives[int(row)] for row in kept),
        **dict(zip(names, (lower, upper, fastest), strict=True)),
    }
