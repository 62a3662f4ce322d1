"""Joints of a description that do not move on their own: mimicking joints, equality constraints, loops."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.actuators.mimic import MimicJoint
from trajopt.robot.data import VisualSource
from trajopt.robot.mjcf import compile_mjcf, joint_names
from trajopt.robot.mjcf_actuators import actuation_of
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.reading import existing_file, require_xml

# Values of MuJoCo's mjtWrap.
WRAP_JOINT, WRAP_SITE, WRAP_GEOMS = 1, 3, (4, 5)


class Coupling(NamedTuple):
    """A constraint: ``what`` describes it, ``joints`` are in it, locking those ``needed`` frees the others.

    mimic: rule by which one of two joints follows the other; None for other constraints. driven, led: whether
    the follower and the leader have motors, as far as the file says.
    """

    what: str
    joints: tuple[str, ...]
    needed: tuple[str, ...]
    mimic: MimicJoint | None = None
    driven: bool = False
    led: bool = False


def following(
    path: str | Path, couplings: Sequence[Coupling], locked: Sequence[str]
) -> dict[MimicJoint, bool]:
    """Mimic joints of a file that are not ``locked``, and whether each has a motor of its own.

    A joint that follows a follower is made to follow the leader of that one. Raises `InputError` for unlocked
    joints that depend on others in another way.
    """
    mimics = {each.mimic.joint: each.mimic for each in couplings if each.mimic}
    for name in mimics:
        for _ in mimics:
            mimic, leader = mimics[name], mimics.get(mimics[name].mimics)
            if leader is not None:
                ratio, offset = mimic.ratio * leader.ratio, mimic.ratio * leader.offset + mimic.offset
                mimics[name] = replace(mimic, mimics=leader.mimics, ratio=ratio, offset=offset)
    twice = Counter(each.mimic.joint for each in couplings if each.mimic)
    broken = [
        each
        for each in couplings
        if (each.mimic is None or twice[each.mimic.joint] > 1) and not set(each.needed) <= set(locked)
    ]
    if broken:
        joints = list(dict.fromkeys(joint for each in broken for joint in each.joints))
        what = "; ".join(each.what for each in broken)
        raise InputError(f"joints of {path} are not independent: {what}", f"lock them: locked={joints}")
    driven = {each.mimic.joint: each.driven for each in couplings if each.mimic}
    return {mimic: driven[name] for name, mimic in mimics.items() if name not in locked}


def couplings_of(source: VisualSource) -> tuple[Coupling, ...]:
    """Couplings of the joints of a description. Raises `InputError` for one that cannot be read."""
    return mjcf_couplings(compile_mjcf(source.urdf)) if source.is_mjcf else urdf_couplings(source.urdf)


def urdf_couplings(path: str | Path) -> tuple[Coupling, ...]:
    """Couplings of a URDF file's moving mimic joints. Raises `InputError` if it is not a URDF file."""
    found, joints = [], require_xml(existing_file(path, "URDF")).findall("joint")
    moving = [joint.get("name", "") for joint in joints if joint.get("type") != "fixed"]
    for joint in joints:
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is not None and name in moving:
            other = mimic.get("joint", "")
            pair = tuple(each for each in (other, name) if each in moving)
            ratio, offset = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
            rule = None
            if len(pair) == 2 and joint.get("type") != "continuous":
                rule = MimicJoint(joint=name, mimics=other, ratio=ratio, offset=offset)
            found.append(Coupling(f"'{name}' mimics '{other}'", pair, (name,), rule))
    return tuple(found)


def mjcf_couplings(compiled: Any) -> tuple[Coupling, ...]:
    """Active equality constraints of a compiled MJCF file between joints that move."""
    found, followers = list[Coupling](), set[str]()
    names, motors = joint_names(compiled), actuation_of(compiled).driven
    for index in np.flatnonzero(compiled.eq_active0).tolist():
        kind = mujoco_package().mjtEq(int(compiled.eq_type[index])).name.removeprefix("mjEQ_").lower()
        objects = [int(compiled.eq_obj1id[index]), int(compiled.eq_obj2id[index])]
        sites = compiled.eq_objtype[index] == mujoco_package().mjtObj.mjOBJ_SITE
        joints = tuple(names[joint] for joint in _joints_of(compiled, kind, objects, bool(sites)))
        if joints:
            name = f" '{compiled.equality(index).name}'" if compiled.equality(index).name else ""
            what = f"equality {kind}{name} of {', '.join(joints)}"
            rule = _mimic(compiled, index, joints) if kind == "joint" and len(joints) == 2 else None
            follows, leads = motors[objects].tolist() if rule else (False, False)
            if rule and follows and not leads and rule.ratio and rule.mimics not in followers:
                rule, follows, leads = rule.swapped(), False, True  # the one with a motor leads
            followers |= {rule.joint} if rule else set()
            found.append(Coupling(what, joints, joints, rule, follows, leads))
    return tuple(found)


def _mimic(compiled: Any, index: int, joints: tuple[str, ...]) -> MimicJoint | None:
    """Rule by which the first joint of an equality follows the second; None if it is not linear."""
    constant, ratio, *others = compiled.eq_data[index][:5].tolist()
    if any(others):
        return None
    one, two = (compiled.qpos0[compiled.jnt_qposadr[compiled.joint(name).id]] for name in joints)
    offset = float(one + constant - ratio * two)
    return MimicJoint(joint=joints[0], mimics=joints[1], ratio=float(ratio), offset=offset)


def _joints_of(compiled: Any, kind: str, objects: list[int], sites: bool) -> list[int]:
    given = [each for each in objects if each >= 0]
    if kind == "joint":
        return given
    if kind == "tendon":
        return sorted({joint for tendon in given for joint in _of_tendon(compiled, tendon)})
    if kind in ("connect", "weld"):
        return _between(compiled, [int(compiled.site_bodyid[each]) for each in given] if sites else objects)
    return []


def _of_tendon(compiled: Any, tendon: int) -> list[int]:
    """Joints that change a tendon's length."""
    start, joints, bodies = int(compiled.tendon_adr[tendon]), [], []
    for wrap in range(start, start + int(compiled.tendon_num[tendon])):
        kind, what = compiled.wrap_type[wrap], int(compiled.wrap_objid[wrap])
        if kind == WRAP_JOINT:
            joints.append(what)
        elif kind in (WRAP_SITE, *WRAP_GEOMS):
            bodies.append(int((compiled.site_bodyid if kind == WRAP_SITE else compiled.geom_bodyid)[what]))
    return joints + _between(compiled, bodies)


def _between(compiled: Any, bodies: Sequence[int]) -> list[int]:
    """Joints on the paths between bodies: above some of them, but not above all."""
    above = Counter[int]()
    for body in bodies:
        while body > 0:
            above[body] += 1
            body = int(compiled.body_parentid[body])
    return [joint for joint, body in enumerate(compiled.jnt_bodyid) if 0 < above[int(body)] < len(bodies)]
