"""Joints of a description that do not move on their own: mimicking joints, equality constraints, loops."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.data import VisualSource
from trajopt.robot.mjcf import compile_mjcf, joint_names
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.reading import existing_file, require_xml


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """A constraint between joints: ``what`` it is, and the ``joints`` that take part in it.

    needed: those of them that must be locked for the rest to be independent.
    """

    what: str
    joints: tuple[str, ...]
    needed: tuple[str, ...]


def require_independent(path: str | Path, couplings: Sequence[Coupling], locked: Sequence[str]) -> None:
    """Raise `InputError` for joints of a file that others drive, unless they are among those ``locked``."""
    broken = [each for each in couplings if not set(each.needed) <= set(locked)]
    if broken:
        joints = list(dict.fromkeys(joint for each in broken for joint in each.joints))
        what = "; ".join(each.what for each in broken)
        raise InputError(f"joints of {path} are not independent: {what}", f"lock them: locked={joints}")


def couplings_of(source: VisualSource) -> tuple[Coupling, ...]:
    """Couplings of the joints of a description. Raises `InputError` for MJCF that cannot be read."""
    return mjcf_couplings(compile_mjcf(source.urdf)) if source.is_mjcf else urdf_couplings(source.urdf)


def urdf_couplings(path: str | Path) -> tuple[Coupling, ...]:
    """Joints of a URDF file that move and mimic another. Raises `InputError` for one that is no URDF."""
    found, joints = [], require_xml(existing_file(path, "URDF")).findall("joint")
    moving = [joint.get("name", "") for joint in joints if joint.get("type") != "fixed"]
    for joint in joints:
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is not None and name in moving:
            other = mimic.get("joint", "")
            pair = tuple(each for each in (other, name) if each in moving)
            found.append(Coupling(what=f"'{name}' mimics '{other}'", joints=pair, needed=(name,)))
    return tuple(found)


def mjcf_couplings(compiled: Any) -> tuple[Coupling, ...]:
    """Active equality constraints of a compiled MJCF file between joints that move."""
    mujoco, found = mujoco_package(), []
    for index in np.flatnonzero(compiled.eq_active0).tolist():
        kind = mujoco.mjtEq(int(compiled.eq_type[index])).name.removeprefix("mjEQ_").lower()
        name = mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_EQUALITY, index)
        objects = [int(compiled.eq_obj1id[index]), int(compiled.eq_obj2id[index])]
        joints = tuple(joint_names(compiled)[joint] for joint in _joints_of(compiled, kind, index, objects))
        if joints:
            what = f"equality {kind} '{name}'" if name else f"equality {kind}"
            found.append(Coupling(what=f"{what} of {', '.join(joints)}", joints=joints, needed=joints))
    return tuple(found)


def _joints_of(compiled: Any, kind: str, index: int, objects: list[int]) -> list[int]:
    mujoco = mujoco_package()
    if kind == "joint":
        return [joint for joint in objects if joint >= 0]
    if kind == "tendon":
        return sorted({joint for tendon in objects if tendon >= 0 for joint in _of_tendon(compiled, tendon)})
    if kind not in ("connect", "weld"):
        return []
    if compiled.eq_objtype[index] == mujoco.mjtObj.mjOBJ_SITE:
        objects = [int(compiled.site_bodyid[site]) for site in objects]
    return _between(compiled, objects)


def _of_tendon(compiled: Any, tendon: int) -> list[int]:
    """Joints that change a tendon's length."""
    kinds, start = mujoco_package().mjtWrap, int(compiled.tendon_adr[tendon])
    joints, bodies = [], []
    for wrap in range(start, start + int(compiled.tendon_num[tendon])):
        kind, what = compiled.wrap_type[wrap], int(compiled.wrap_objid[wrap])
        if kind == kinds.mjWRAP_JOINT:
            joints.append(what)
        elif kind == kinds.mjWRAP_SITE:
            bodies.append(int(compiled.site_bodyid[what]))
        elif kind in (kinds.mjWRAP_SPHERE, kinds.mjWRAP_CYLINDER):
            bodies.append(int(compiled.geom_bodyid[what]))
    return joints + _between(compiled, bodies)


def _between(compiled: Any, bodies: Sequence[int]) -> list[int]:
    """Joints on the paths between bodies."""
    paths: list[set[int]] = []
    for body in bodies:
        path = set[int]()
        while body > 0:
            path.add(body)
            body = int(compiled.body_parentid[body])
        paths.append(path)
    counts = Counter(body for path in paths for body in path)
    return [joint for joint, body in enumerate(compiled.jnt_bodyid) if 0 < counts[int(body)] < len(paths)]
