"""What a robot's description has that its model does not use, by kind and name."""

from typing import Any
from xml.etree import ElementTree

import numpy as np

from trajopt.robot.coupling import couplings_of
from trajopt.robot.mjcf import body_names, compile_mjcf, joint_names
from trajopt.robot.mjcf_actuators import effort_limits
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.robot import Robot

FLUID = ("density", "viscosity", "wind")


def unused_parts(robot: Robot) -> dict[str, list[str]]:
    """Names of parts, by what they are. Raises `InputError` for a file that cannot be read."""
    source = robot.visual
    if source is None or not source.urdf.is_file():
        return {}
    moving, found = set(robot.model.names), dict[str, list[str]]()
    for coupling in couplings_of(source):
        kept = moving.intersection(coupling.needed)
        what = "couplings of joints" if kept else "couplings of joints, which are locked"
        found.setdefault(what, []).append(coupling.what)
    if source.is_mjcf:
        return found | _of_mjcf(compile_mjcf(source.urdf))
    root = ElementTree.parse(source.urdf).getroot()
    found["transmissions"] = [each.get("name", "") for each in root.findall("transmission")]
    guarded = [each for each in root.findall("joint") if each.find("safety_controller") is not None]
    return found | {"safety controllers": [each.get("name", "") for each in guarded]}


def _of_mjcf(compiled: Any) -> dict[str, list[str]]:
    kinds, joints = mujoco_package().mjtObj, np.array(joint_names(compiled), dtype=object)
    balls = compiled.jnt_type == mujoco_package().mjtJoint.mjJNT_BALL
    named = {
        what: [
            mujoco_package().mj_id2name(compiled, kind, index) or f"{what}{index}" for index in range(count)
        ]
        for what, kind, count in (
            ("tendons", kinds.mjOBJ_TENDON, compiled.ntendon),
            ("flexes", kinds.mjOBJ_FLEX, compiled.nflex),
        )
    }
    return named | {
        "actuators other than of hinges and slides": list(effort_limits(compiled).others),
        "springs of joints": joints[compiled.jnt_stiffness != 0].tolist(),
        "limits of ball joints": joints[balls & compiled.jnt_limited.astype(bool)].tolist(),
        "gravity compensation of bodies": [
            name for name, part in zip(body_names(compiled), compiled.body_gravcomp, strict=True) if part
        ],
        "fluid forces": [name for name in FLUID if np.any(getattr(compiled.opt, name))],
    }
