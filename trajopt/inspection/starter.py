"""From a URDF file to a first ``robot.py``: feet and a standing posture guessed from geometry."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import Base, position_limits
from trajopt.errors import InputError
from trajopt.inspection.faults import shapes_of
from trajopt.inspection.limbs import find_limbs, tool_joint
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.legs import LIFTED
from trajopt.robot.reading import read_urdf
from trajopt.robot.robot import Robot

# Fraction of the height over the feet by which the base is lowered from all joints at zero: bent knees.
BENT = 0.15
# Inverse kinematics has succeeded if feet are in place up to this fraction of the height.
REACHED = 1e-6
# A ball is a foot's if its centre is this near to the foot's frame, m.
SAME_PLACE = 1e-6
# Iterations: moving the legs shifts the centre of mass, by less each time.
CENTRINGS = 4
# A description this many folders up is given by its absolute path.
FAR = ("..", "..", "..")

TEMPLATE = '''"""Robot "{name}" of {source}. Feet and posture are guesses from geometry: edit them."""

from pathlib import Path

from trajopt import {imported}

URDF = Path(__file__).parent / "{file}"
{tool}# The standing posture by joint, rad (m where a joint slides); the limits beside it.
REFERENCE = {{
{reference}
}}


def build() -> Robot:
    """Return the robot in its reference posture."""
    return Robot.from_urdf(
        URDF,
        name="{name}",
        base="{base}",
        contacts={contacts},{locked}
        reference=REFERENCE,
    )
'''


def guessed(urdf: Path, base: Base | None = None) -> Robot:
    """Return the robot of a URDF file with guessed base, feet and posture.

    base: by default fixed for an arm, a chain with a light hand or none, and on wheels; else free. Wheels,
    and joints of hands without drive, are locked (`find_limbs`). Feet are the tips at the bottom with all
    joints at zero, or as near as limits allow; the posture bends the legs, with the feet's middle under the
    centre of mass, where inverse kinematics finds a way. Raises `InputError` for a file that is not a URDF.
    """
    limbs = find_limbs(read_urdf(urdf, "fixed"))
    kind: Base = base or ("fixed" if limbs.is_fixed else "freeflyer")
    feet = [] if kind == "fixed" or limbs.wheels else _lowest_tips(read_urdf(urdf, kind))
    made = Robot.from_urdf(urdf, base=kind, contacts=feet, locked=(*limbs.wheels, *limbs.undriven))
    contacts = [replace(contact, radius=_ball_at(made, contact.frame)) for contact in made.contacts]
    return _bent(Robot.from_urdf(urdf, base=kind, contacts=contacts, locked=(*limbs.wheels, *limbs.undriven)))


def _ball_at(robot: Robot, name: str) -> float:
    """Radius of the ball that the description has around a frame, m; 0 without one."""
    frame = robot.model.frames[robot.model.getFrameId(name)]
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        try:
            geometry = shapes_of(robot, kind)
        except InputError:
            continue
        for shape in [] if geometry is None else geometry.geometryObjects:
            apart = np.linalg.norm(shape.placement.translation - frame.placement.translation)
            belongs = shape.parentJoint == frame.parentJoint and apart < SAME_PLACE
            if belongs and type(shape.geometry).__name__ == "Sphere":
                return float(shape.geometry.radius)
    return 0.0


def starter(robot: Robot, target: Path) -> str:
    """Return the text of a Python file, to be written at ``target``, that builds ``robot`` of a URDF file."""
    if robot.visual is None:
        raise InputError(f"robot '{robot.name}' was not read from a URDF file", "a robot of Robot.from_urdf")
    urdf = robot.visual.urdf
    near = Path(os.path.relpath(urdf, target.absolute().parent))
    file = (urdf if near.parts[: len(FAR)] == FAR else near).as_posix()
    known = set(robot.model.names)
    locked = [name for name in read_urdf(urdf, robot.base).names if name not in known]
    tool = ""
    if robot.base == "fixed":
        end = tool_joint(robot.model)
        last = [f.name for f in robot.model.frames if f.parentJoint == end > 0]
        tool = f'KIND, TOOL = "arm", "{last[-1]}"\n' if last else ""
    contacts = ", ".join(
        f'Contact(frame="{c.frame}", radius={c.radius:g})' if c.radius else f'"{c.frame}"'
        for c in robot.contacts
    )
    return TEMPLATE.format(
        name=robot.name,
        file=file,
        source=urdf.name,
        tool=tool,
        base=robot.base,
        contacts=f"[{contacts}]",
        locked=f"\n        locked={locked}," if locked else "",
        imported="Contact, Robot" if any(c.radius for c in robot.contacts) else "Robot",
        reference="\n".join(_entries(robot)),
    )


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
    """Three decimals, or as many as keep the value within its limits."""
    short = round(float(value), 3) + 0.0
    return f"{short:g}" if lower <= short <= upper or np.isnan(lower) else f"{float(value)!r}"


def _tips(model: pin.Model) -> dict[int, str]:
    """The farthest body frame of every joint without children: joint -> frame."""
    parents = {int(parent) for parent in list(model.parents)[1:]}
    tips: dict[int, tuple[float, str]] = {}
    for frame in model.frames:
        joint = int(frame.parentJoint)
        if joint == 0 or joint in parents or frame.type != pin.FrameType.BODY:
            continue
        distance = float(np.linalg.norm(frame.placement.translation))
        if joint not in tips or distance > tips[joint][0]:
            tips[joint] = (distance, frame.name)
    return {joint: name for joint, (_, name) in tips.items()}


def _lowest_tips(model: pin.Model) -> list[str]:
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.clip(pin.neutral(model), *position_limits(model)))
    heights = {name: data.oMf[model.getFrameId(name)].translation[2] for name in _tips(model).values()}
    lowest = min(heights.values(), default=0.0)
    # A root may lie on the ground, as base_footprint does: the height is that of all frames.
    within = LIFTED * (max((place.translation[2] for place in data.oMf), default=0.0) - lowest)
    return [name for name, height in heights.items() if height - lowest <= within]


def _bent(straight: Robot) -> Robot:
    """The robot with its base lowered over feet below the centre of mass, where such a posture exists."""
    if straight.base != "freeflyer" or not straight.contacts:
        return straight
    model, data = straight.model, straight.model.createData()
    places = contact_positions(straight, straight.reference)
    middle = np.mean(list(places.values()), axis=0)
    q = straight.reference.copy()
    q[2] -= BENT * straight.length
    for _ in range(CENTRINGS):
        shift = pin.centerOfMass(model, data, q) - middle
        shift[2] = 0.0
        feet = {contact.frame: places[contact.name] + shift for contact in straight.contacts}
        result = inverse_kinematics(straight, q, feet)
        if result.error > REACHED * straight.length:
            return straight
        q = result.q
    return replace(straight, reference=q)
