"""A first ``robot.py`` from a URDF or MJCF file, with feet and a posture guessed from geometry."""

import json
import os
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.collision.hulls import read_shapes
from trajopt.dynamics.base_joint import Base, position_limits
from trajopt.errors import InputError
from trajopt.inspection.faults import listed
from trajopt.inspection.limbs import Limbs, find_limbs, tool_joint
from trajopt.inspection.posture import bent_arm, standing
from trajopt.robot.building import locked_model, torque_limit_of, velocity_limit_of
from trajopt.robot.contact import Contact
from trajopt.robot.coupling import Coupling, couplings_of
from trajopt.robot.data import DATA_PACKAGE, VisualSource, package_directories
from trajopt.robot.joint_checks import without_zero_limits
from trajopt.robot.reading import read_urdf
from trajopt.robot.robot import Robot

# A description this many folders up is given by its absolute path.
FAR_FOLDER = ("..", "..", "..")
# Descriptions of the robot data package, as files name them.
SHIPPED = f"{DATA_PACKAGE}/robots/"
FRAMES = """# Frames that the description lacks: what each is fixed to, place, m, and turn (rpy), rad, in it.
FRAMES = {{
{}}}
"""
SHAPED = """[
{}        ]"""
ZEROS = "    return without_zero_limits(robot, REFERENCE)  # zeros of the file stand for no limit\n"
TEMPLATE = '''"""Robot "{name}" of {source}. Feet and posture are guesses from geometry: edit them."""

{path}from trajopt import {imported}
{helpers}
{kind} = {place}
{tool}{frames}# The standing posture by joint, rad (m where a joint slides); the limits beside it.
REFERENCE = {{
{reference}
}}


def build() -> Robot:
    """Return the robot in its reference posture."""
    {result}Robot.from_{reader}(
        {kind},
        name="{name}",
        base="{base}",
        contacts={contacts},{placed}{posture}{locked}
    )
{unlimited}'''


def guessed(path: Path, base: Base | None = None) -> Robot:
    """Return the robot of a URDF or MJCF file with guessed base, feet and posture.

    The default ``base`` is that of an MJCF file. For a URDF file it is free where there are legs, or wheels
    alone, else fixed. Feet are the ends of the lowest limbs: balls, soles, wheels that roll, or points.
    Locked are wheels of a fixed base, joints of hands without drive (`find_limbs`), and joints that follow
    others, with their leaders, unless these have motors of their own or move a foot. Legs are bent with the
    centre of mass above the feet (`standing`), arms away from singularities (`bent_arm`). The keyframe of an
    MJCF file takes precedence over both. Raises `InputError` for a file that is neither.
    """
    is_mjcf, limbs = VisualSource(urdf=path).is_mjcf, limbs_of(path)
    usual: Base = "fixed" if limbs.is_fixed else "freeflyer"
    kind = base or (Robot.from_mjcf(path, locked=limbs.coupled).base if is_mjcf else usual)
    locked = (*limbs.coupled, *limbs.undriven, *(limbs.wheels if kind == "fixed" else ()))
    build = partial(Robot.from_mjcf if is_mjcf else Robot.from_urdf, path, locked=locked, base=kind)
    if kind == "fixed":
        return bent_arm(without_zero_limits(build()))
    return standing(without_zero_limits(build(frames=limbs.frames, contacts=limbs.contacts)))


def guess_lines(path: Path) -> tuple[str, ...]:
    """Lines that say which joints of a description a guess locks."""
    limbs = limbs_of(path)
    wheels = f"guess: wheels, locked as the base is fixed: {listed(limbs.wheels)}"
    undriven = f"guess: joints at the ends without drive or mass, locked: {listed(limbs.undriven)}"
    return (wheels,) * bool(limbs.wheels and limbs.is_fixed) + (undriven,) * bool(limbs.undriven)


def limbs_of(path: Path) -> Limbs:
    """Limbs of a URDF or MJCF file on a fixed base, and its coupled joints that a guess locks."""
    return _limbs_of(path, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache(maxsize=2)
def _limbs_of(path: Path, _changed: int) -> Limbs:
    source = VisualSource(urdf=path, package_dirs=package_directories(path.absolute()))
    couplings = couplings_of(source)
    coupled = _joints(each for each in couplings if not (each.driven or each.led))
    if source.is_mjcf:
        robot = Robot.from_mjcf(path, locked=coupled)
        if robot.base == "fixed":
            return Limbs(coupled=coupled)
        still = locked_model(robot.model, (robot.model.names[1],), pin.neutral(robot.model))
        return replace(find_limbs(still, read_shapes(source, still)[0]), coupled=coupled)
    model = read_urdf(path, "fixed")
    limbs = _found(source, model, coupled)
    if coupled and not limbs.is_fixed:  # a follower may be a knee
        limbs = _found(source, model, _joints(each for each in couplings if each.mimic is None))
        held = {c.frame: limbs.frames.get(c.frame, (c.frame,))[0] for c in limbs.contacts}.values()
        above = {
            str(model.names[joint])
            for frame in held
            for joint in model.supports[model.frames[model.getFrameId(frame)].parentJoint]
        }
        coupled = _joints(each for each in couplings if not above.intersection(each.joints))
    return replace(limbs, coupled=coupled)


def _found(source: VisualSource, model: pin.Model, locked: tuple[str, ...]) -> Limbs:
    still = locked_model(model, locked, pin.neutral(model))
    return find_limbs(still, read_shapes(source, still)[0])


def _joints(couplings: Iterable[Coupling]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(joint for each in couplings for joint in each.joints))


def starter(robot: Robot, target: Path) -> str:
    """Return the text of a Python file, to be written at ``target``, that builds ``robot`` from its file."""
    if robot.visual is None:
        raise InputError(f"robot '{robot.name}' was not read from a file", "a robot of Robot.from_urdf")
    urdf, limbs, zeros = robot.visual.urdf, limbs_of(robot.visual.urdf), _has_zeros(robot)
    guessed = (*limbs.coupled, *limbs.undriven, *limbs.wheels)
    locked = [joint for joint in guessed if not robot.model.existJointName(joint)]
    frames = {n: f for n, f in limbs.frames.items() if robot.model.existFrame(n)}
    tool, reader = "", "mjcf" if robot.visual.is_mjcf else "urdf"
    if robot.base == "fixed":
        end = tool_joint(robot.model)
        last = [f.name for f in robot.model.frames if f.parentJoint == end > 0]
        tool = f'KIND, TOOL = "arm", "{last[-1]}"\n' if last else ""
    contacts = [_contact(contact) for contact in robot.contacts]
    shaped = any(contact.startswith("Contact") for contact in contacts)
    added = "".join(f'    "{name}": {json.dumps(frame)},\n' for name, frame in frames.items())
    place = _place(urdf, target)
    helpers = [name for name in ("robot_file",) if place.startswith(name)] + ["without_zero_limits"] * zeros
    return TEMPLATE.format(
        name=robot.name,
        source=urdf.name,
        path="" if place.startswith("robot_file") else "from pathlib import Path\n\n",
        imported="Contact, Robot" if shaped else "Robot",
        helpers=f"from trajopt.robot import {', '.join(helpers)}\n" if helpers else "",
        kind=reader.upper(),
        place=place,
        tool=tool,
        frames=FRAMES.format(added) if frames else "",
        reference="\n".join(_entries(robot)),
        result="robot = " if zeros else "return ",
        reader=reader,
        base=robot.base,
        contacts=SHAPED.format("".join(f"            {each},\n" for each in contacts))
        if shaped
        else f"[{', '.join(contacts)}]",
        placed="\n        frames=FRAMES," if frames else "",
        posture="" if zeros else "\n        reference=REFERENCE,",
        locked=f"\n        locked={json.dumps(locked)}," if locked else "",
        unlimited=ZEROS if zeros else "",
    )


def _place(urdf: Path, target: Path) -> str:
    """The path of a description as Python: within the robot data package, beside the file, or absolute."""
    shipped = VisualSource(urdf=Path(os.path.normpath(urdf))).to_meta()["urdf"]
    if shipped.startswith(SHIPPED):
        return f'robot_file("{shipped.removeprefix(SHIPPED)}")'
    near = Path(os.path.relpath(urdf, target.absolute().parent))
    file = (urdf if near.parts[: len(FAR_FOLDER)] == FAR_FOLDER else near).as_posix()
    return f'Path(__file__).parent / "{file}"'


def _has_zeros(robot: Robot) -> bool:
    """Whether the file of a robot writes zeros for no limit."""
    lower, upper = position_limits(robot.model)
    rates = velocity_limit_of(robot.model, robot.base)
    torque = torque_limit_of(robot.model, robot.base, robot.passive)
    return bool((lower == upper).any() or (rates == 0).any() or (torque is not None and not torque.any()))


def _contact(contact: Contact) -> str:
    """A contact as Python; a point without a size is the name of its frame."""
    if contact.kind == "surface":
        size = f'kind="surface", half_length={contact.half_length:g}, half_width={contact.half_width:g}'
        return f'Contact(frame="{contact.frame}", {size})'
    rolls = ", rolling=True" if contact.rolling else ""
    if not contact.radius:
        return f'"{contact.frame}"'
    return f'Contact(frame="{contact.frame}", radius={contact.radius:g}{rolls})'


def _entries(robot: Robot) -> list[str]:
    entries = []
    first = 0 if robot.base == "fixed" else 2 if robot.base in ("freeflyer", "planar") else 7
    for joint in list(robot.model.joints)[max(first, 1) :]:
        if joint.nv != 1:
            continue
        q = robot.reference[joint.idx_q : joint.idx_q + joint.nq]
        value = q[0] if joint.nq == 1 else np.arctan2(q[1], q[0])
        lower, upper = robot.position_lower[joint.idx_q], robot.position_upper[joint.idx_q]
        limits = f"{lower:.4g} to {upper:.4g}" if joint.nq == 1 and np.isfinite(lower) else "without limits"
        entries.append(f'    "{robot.model.names[joint.id]}": {_within(value, lower, upper)},  # {limits}')
    return entries


def _within(value: float, lower: float, upper: float) -> str:
    """Four decimals, or as many as keep the value within its limits."""
    short = round(float(value), 4) + 0.0
    return f"{short:g}" if lower <= short <= upper or np.isnan(lower) else f"{float(value)!r}"
