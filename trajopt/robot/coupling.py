"""Joints of a description that do not move on their own: mimicking joints, equality constraints, loops."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.data import VisualSource
from trajopt.robot.mjcf import compile_mjcf, joint_names
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.reading import existing_file, require_xml

# Of MuJoCo's mjtWrap.
WRAP_JOINT, WRAP_SITE, WRAP_GEOMS = 1, 3, (4, 5)


class Coupling(NamedTuple):
    """A constraint: ``what`` it is, its ``joints``, and those ``needed`` to be locked to free the others."""

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
    """Couplings of the joints of a description. Raises `InputError` for one that cannot be read."""
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
            found.append(Coupling(f"'{name}' mimics '{other}'", pair, (name,)))
    return tuple(found)


def mjcf_couplings(compiled: Any) -> tuple[Coupling, ...]:
    """Active equality constraints of a compiled MJCF file between joints that move."""
    found, names = [], joint_names(compiled)
    for index in np.flatnonzero(compiled.eq_active0).tolist():
        kind = mujoco_package().mjtEq(int(compiled.eq_type[index])).name.removeprefix("mjEQ_").lower()
        objects = [int(compiled.eq_obj1id[index]), int(compiled.eq_obj2id[index])]
        sites = compiled.eq_objtype[index] == mujoco_package().mjtObj.mjOBJ_SITE
        joints = tuple(names[joint] for joint in _joints_of(compiled, kind, objects, bool(sites)))
        if joints:
            name = f" '{compiled.equality(index).name}'" if compiled.equality(index).name else ""
            found.append(Coupling(f"equality {kind}{name} of {', '.join(joints)}", joints, joints))
    return tuple(found)


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
