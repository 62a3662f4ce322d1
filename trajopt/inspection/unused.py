"""What a robot's description has that its model does not use, by kind and name."""

from typing import Any

import numpy as np

from trajopt.robot.coupling import couplings_of
from trajopt.robot.mjcf import body_names, compile_mjcf, joint_names
from trajopt.robot.mjcf_actuators import BALL, actuation_of
from trajopt.robot.reading import require_xml
from trajopt.robot.robot import Robot


def unused_parts(robot: Robot) -> dict[str, list[str]]:
    """Names of parts, by what they are. Raises `InputError` for a file that cannot be read."""
    source, moving, found = robot.visual, set(robot.model.names), dict[str, list[str]]()
    if source is None or not source.urdf.is_file():
        return {}
    for coupling in couplings_of(source):
        if not moving.intersection(coupling.needed):
            found.setdefault("couplings of joints, which are locked", []).append(coupling.what)
    if source.is_mjcf:
        return found | _of_mjcf(compile_mjcf(source.urdf), {thruster.name for thruster in robot.thrusters})
    root = require_xml(source.urdf)
    guarded = [each for each in root.findall("joint") if each.find("safety_controller") is not None]
    parts = {"transmissions": root.findall("transmission"), "safety controllers": guarded}
    return found | {what: [each.get("name", "") for each in these] for what, these in parts.items()}


def _of_mjcf(compiled: Any, thrusters: set[str]) -> dict[str, list[str]]:
    actuation = actuation_of(compiled)
    idle = [thruster.name for thruster in actuation.thrusters if thruster.name not in thrusters]
    joints, bodies = np.array(joint_names(compiled)), np.array(body_names(compiled))
    limited = (compiled.jnt_type == BALL) & compiled.jnt_limited.astype(bool)
    return {
        "actuators other than of hinges, slides and thrusters on the base": [*actuation.others, *idle],
        "tendons": [compiled.tendon(index).name or f"tendon{index}" for index in range(compiled.ntendon)],
        "flexes": [f"flex{index}" for index in range(compiled.nflex)],
        "springs of joints": joints[compiled.jnt_stiffness != 0].tolist(),
        "limits of ball joints": joints[limited].tolist(),
        "gravity compensation of bodies": bodies[compiled.body_gravcomp != 0].tolist(),
        "fluid forces": [n for n in ("density", "viscosity", "wind") if np.any(getattr(compiled.opt, n))],
    }
