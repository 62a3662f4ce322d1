"""A first ``robot.py`` from a URDF or MJCF file, with feet and a standing posture guessed from geometry."""

import json
import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import UNLIMITED, Base
from trajopt.errors import InputError
from trajopt.inspection.faults import listed, shapes_of
from trajopt.robot.building import locked_model, reference_posture
from trajopt.robot.coupling import couplings_of
from trajopt.robot.data import VisualSource
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.legs import HAND_HEIGHT
from trajopt.robot.reading import read_urdf
from trajopt.robot.robot import Robot

# A hand weighs at most the first fraction of what its arm's first joint moves; a joint without drive moves at
# most the second fraction of the total mass.
HAND_MASS, IDLE_MASS = 0.25, 0.02
# Bounds for a wheel: sine of its axis's angle to the ground, distance of its centre of mass from the axis
# over its radius of gyration, height of its axis over the lowest tip relative to the height of all joints.
WHEEL_TILT, WHEEL_OFFSET, WHEEL_HEIGHT = 0.1, 0.2, 0.1
# Fraction of the height over the feet by which the base is lowered, from all joints at zero, to bend knees.
KNEE_BEND = 0.15
# Inverse kinematics has succeeded if feet are in place up to this fraction of the height.
FOOT_ERROR = 1e-6
# A ball belongs to a foot if its centre is this near to the foot's frame, m.
SAME_PLACE = 1e-6
# Iterations: moving the legs shifts the centre of mass, by less each time.
CENTRINGS = 4
# A description this many folders up is given by its absolute path.
FAR_FOLDER = ("..", "..", "..")
# Kinds of frames that may be feet: links and, in MJCF files, balls and sites.
TIPS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
TEMPLATE = '''"""Robot "{name}" of {source}. Feet and posture are guesses from geometry: edit them."""

from pathlib import Path

from trajopt import {imported}

{kind} = Path(__file__).parent / "{file}"
{tool}# The standing posture by joint, rad (m where a joint slides); the limits beside it.
REFERENCE = {{
{reference}
}}


def build() -> Robot:
    """Return the robot in its reference posture."""
    return Robot.from_{reader}(
        {kind},
        name="{name}",
        base="{base}",
        contacts={contacts},
        reference=REFERENCE,{locked}
    )
'''


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """Names of joints that a guess locks, and whether it fixes the base, as for an arm or on wheels."""

    wheels: tuple[str, ...]
    undriven: tuple[str, ...]
    is_fixed: bool

    def lines(self) -> tuple[str, ...]:
        """Lines that say what a guess does with them."""
        wheels = f"guess: wheels, locked and not taken as feet: {listed(self.wheels)}"
        undriven = f"guess: joints at the ends without drive or mass, locked: {listed(self.undriven)}"
        return (wheels,) * bool(self.wheels) + (undriven,) * bool(self.undriven)


def find_limbs(model: pin.Model) -> Limbs:
    """Limbs of a model on a fixed base, with all joints at zero.

    A joint without drive moves no mass; or it moves little, and has an effort limit of 0 or none while others
    have one. Tips at the bottom are not counted among them, as they may be feet.
    """
    data, joints, children = model.createData(), range(1, model.njoints), _children(model)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.computeSubtreeMasses(model, data)
    heights = np.array([place.translation[2] for place in data.oMi])
    tips = [joint for joint in joints if not children[joint]]
    low = min((heights[tip] for tip in tips), default=0.0) + WHEEL_HEIGHT * np.ptp(heights)
    bottom = {tip for tip in tips if heights[tip] <= low}
    wheels = {joint for joint in bottom if _is_wheel(model, data, joint)}
    wheels = wheels if len(wheels) > 1 else set()  # one alone is a flywheel
    is_arm = _is_arm(data, children, wheels)
    undriven: set[int] = set()
    for joint in reversed(joints):
        may_be_foot = joint in bottom and not is_arm
        if not may_be_foot and undriven.issuperset(children[joint]) and _without_drive(model, data, joint):
            undriven.add(joint)
    wheel_names, names = (tuple(str(model.names[j]) for j in sorted(each)) for each in (wheels, undriven))
    return Limbs(wheels=wheel_names, undriven=names, is_fixed=is_arm or bool(wheels))


def tool_joint(model: pin.Model) -> int:
    """The last joint of the heaviest chain, before a light hand; 0 without joints."""
    data, children, joint = model.createData(), _children(model), 0
    pin.computeSubtreeMasses(model, data)
    while children[joint]:
        behind = [float(data.mass[child]) for child in children[joint]]
        if joint and len(behind) > 1 and sum(behind) <= HAND_MASS * data.mass[model.supports[joint][1]]:
            break
        joint = children[joint][int(np.argmax(behind))]
    return joint


def _children(model: pin.Model) -> list[list[int]]:
    parents = list(model.parents)
    return [[k for k in range(1, model.njoints) if parents[k] == joint] for joint in range(model.njoints)]


def _is_arm(data: pin.Data, children: list[list[int]], wheels: set[int]) -> bool:
    """Whether all joints but wheels form one chain, with at most a light hand at its end."""
    branches, chain = [child for child in children[0] if child not in wheels], list[int]()
    while len(branches) == 1:
        chain.append(branches[0])
        branches = children[branches[0]]
    return bool(chain) and sum(data.mass[each] for each in branches) <= HAND_MASS * data.mass[chain[0]]


def _is_wheel(model: pin.Model, data: pin.Data, joint: int) -> bool:
    """Whether a tip turns without limits about a level axis through its body's centre of mass."""
    kind, inertia = model.joints[joint], model.inertias[joint]
    span = model.upperPositionLimit[kind.idx_q] - model.lowerPositionLimit[kind.idx_q]
    endless = kind.nq == 2 or not 0 < span < UNLIMITED
    if kind.nv != 1 or not endless or inertia.mass <= 0:
        return False
    jacobian = np.reshape(data.J, (6, model.nv), order="F")  # of one column it is flat
    axis = jacobian[3:, kind.idx_v]  # world; zero where it slides
    off = np.linalg.norm(np.cross(axis, data.oMi[joint].rotation @ inertia.lever))
    radius = np.sqrt(np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
    return bool(axis.any() and abs(axis[2]) < WHEEL_TILT and off <= WHEEL_OFFSET * radius)


def _without_drive(model: pin.Model, data: pin.Data, joint: int) -> bool:
    driven = (model.upperEffortLimit > 0) & (model.upperEffortLimit < UNLIMITED)
    kind, mass = model.joints[joint], data.mass[joint]
    own = driven[kind.idx_v : kind.idx_v + kind.nv]
    return bool(mass == 0 or (driven.any() and not own.any() and mass <= IDLE_MASS * data.mass[0]))


def guessed(path: Path, base: Base | None = None) -> Robot:
    """Return the robot of a URDF or MJCF file with guessed base, feet and posture.

    The default ``base`` is that of an MJCF file. For a URDF file it is fixed for an arm (a chain with at most
    a light hand) and on wheels, else free. Locked are wheels, joints of hands without drive (`find_limbs`),
    and joints that follow others without a motor of their own, with their leaders. Feet are the lowest tips
    with joints at zero, or as near as limits allow. If inverse kinematics succeeds, the posture bends the
    legs with the centre of mass above the middle of the feet. The keyframe of an MJCF file takes precedence
    over both. Raises `InputError` for a file that is neither.
    """
    source, limbs = VisualSource(urdf=path), limbs_of(path)
    locked = (*_coupled(source), *limbs.wheels, *limbs.undriven)
    build = partial(Robot.from_mjcf if source.is_mjcf else Robot.from_urdf, path, locked=locked)
    usual: Base = "fixed" if limbs.is_fixed else "freeflyer"
    bare = build(base=base or (None if source.is_mjcf else usual))
    kind = bare.base
    if kind == "fixed" or limbs.wheels:
        return bare
    tips = build(base=kind, contacts=_lowest_tips(bare.model, bare.reference))
    contacts = [replace(contact, radius=_ball_at(tips, contact.frame)) for contact in tips.contacts]
    return _bent(build(base=kind, contacts=contacts))


def limbs_of(path: Path) -> Limbs:
    """Limbs of a URDF or MJCF file on a fixed base, with coupled joints locked."""
    source = VisualSource(urdf=path)
    locked = _coupled(source)
    if source.is_mjcf:
        robot = Robot.from_mjcf(path, locked=locked)
        if robot.base == "fixed":
            return Limbs(wheels=(), undriven=(), is_fixed=True)
        model, locked = robot.model, (robot.model.names[1],)
    else:
        model = read_urdf(path, "fixed")
    return find_limbs(locked_model(model, locked, pin.neutral(model)))


def _coupled(source: VisualSource) -> tuple[str, ...]:
    """Joints of all couplings except those with a driven follower: followers and their leaders."""
    led = (each for each in couplings_of(source) if not each.driven)
    return tuple(dict.fromkeys(joint for each in led for joint in each.joints))


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
    """Return the text of a Python file, to be written at ``target``, that builds ``robot`` from its file."""
    if robot.visual is None:
        raise InputError(f"robot '{robot.name}' was not read from a file", "a robot of Robot.from_urdf")
    urdf, reader = robot.visual.urdf, "mjcf" if robot.visual.is_mjcf else "urdf"
    described = _coupled(robot.visual) if robot.visual.is_mjcf else list(read_urdf(urdf, robot.base).names)
    locked = [joint for joint in described if not robot.model.existJointName(joint)]
    near = Path(os.path.relpath(urdf, target.absolute().parent))
    file = (urdf if near.parts[: len(FAR_FOLDER)] == FAR_FOLDER else near).as_posix()
    tool = ""
    if robot.base == "fixed":
        end = tool_joint(robot.model)
        last = [f.name for f in robot.model.frames if f.parentJoint == end > 0]
        tool = f'KIND, TOOL = "arm", "{last[-1]}"\n' if last else ""
    balls = any(contact.radius for contact in robot.contacts)
    contacts = [
        f'Contact(frame="{c.frame}", radius={c.radius:g})' if c.radius else f'"{c.frame}"'
        for c in robot.contacts
    ]
    listed = ", ".join(contacts)
    if balls:
        listed = "".join(f"\n            {contact}," for contact in contacts) + "\n        "
    return TEMPLATE.format(
        name=robot.name,
        kind=reader.upper(),
        reader=reader,
        locked=f"\n        locked={json.dumps(locked)}," if locked else "",
        file=file,
        source=urdf.name,
        tool=tool,
        base=robot.base,
        contacts=f"[{listed}]",
        imported="Contact, Robot" if balls else "Robot",
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
    """The farthest body, ball or site of every joint without children: joint -> frame."""
    parents = {int(parent) for parent in list(model.parents)[1:]}
    tips: dict[int, tuple[float, str]] = {}
    for frame in model.frames:
        joint = int(frame.parentJoint)
        if joint == 0 or joint in parents or frame.type not in TIPS:
            continue
        distance = float(np.linalg.norm(frame.placement.translation))
        if joint not in tips or distance > tips[joint][0]:
            tips[joint] = (distance, frame.name)
    return {joint: name for joint, (_, name) in tips.items()}


def _lowest_tips(model: pin.Model, q: np.ndarray) -> list[str]:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    heights = {name: data.oMf[model.getFrameId(name)].translation[2] for name in _tips(model).values()}
    lowest = min(heights.values(), default=0.0)
    # A root may lie on the ground, as base_footprint does, so the height is taken over all frames.
    within = HAND_HEIGHT * (max((place.translation[2] for place in data.oMf), default=0.0) - lowest)
    return [name for name, height in heights.items() if height - lowest <= within]


def _bent(straight: Robot) -> Robot:
    """The robot with its base lowered and its feet below the centre of mass, if such a posture exists."""
    if straight.base != "freeflyer" or not straight.contacts:
        return straight
    model, data = straight.model, straight.model.createData()
    plain = reference_posture(model, straight.base, straight.contacts, None)
    if not np.allclose(straight.reference[7:], plain[7:]):
        return straight  # a keyframe
    places = contact_positions(straight, straight.reference)
    middle = np.mean(list(places.values()), axis=0)
    q = straight.reference.copy()
    q[2] -= KNEE_BEND * straight.length
    for _ in range(CENTRINGS):
        shift = pin.centerOfMass(model, data, q) - middle
        shift[2] = 0.0
        feet = {contact.frame: places[contact.name] + shift for contact in straight.contacts}
        result = inverse_kinematics(straight, q, feet)
        if result.error > FOOT_ERROR * straight.length:
            return straight
        q = result.q
    return replace(straight, reference=q)
