"""The MuJoCo model of a simulation as an MJCF file, with the names of the robot.

MuJoCo's own writer rounds to six digits and ignores what was written into a compiled model, so the numbers of
bodies and joints are replaced by the exact ones. A motor for each torque of the plan, in its order, and the
keyframes ``start`` and ``end`` are added. The shapes of links and ground are part of the file.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.errors import InputError, expanded, first_line
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.motion.output import replacing
from trajopt.motion.samples import warn_of_payloads
from trajopt.motion.solution import Solution
from trajopt.robot.mujoco_package import mujoco_package, muted_mujoco
from trajopt.simulation.bodies import body_name, joint_axis, mujoco_quaternion, part_name
from trajopt.simulation.scene import Scene, build_scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.site import Site

# Least mass, kg, and inertia, kg m^2, that MuJoCo accepts: far below those of the smallest robots.
LEAST = 1e-12
# The viewer shows this group only on request: ground that is lifted for contacts with a radius.
HIDDEN_GROUP, GROUND_COLOUR = "3", "0.8 0.85 0.9 1"
# Radius, in reaches, of the bones that represent a robot whose links have no shapes.
BONE = 0.02
LIGHT = {"ambient": "0.4 0.4 0.4", "diffuse": "0.6 0.6 0.6", "specular": "0.1 0.1 0.1"}
SKY = {"type": "skybox", "builtin": "gradient", "rgb1": "1 1 1", "rgb2": "0.7 0.8 0.9"}
SKY_SIZE = {"width": "256", "height": "256"}
# Joints that become several MuJoCo joints, and the suffixes of their names.
PARTS = {
    "JointModelPlanar": ("x", "y", "angle"),
    "JointModelTranslation": ("x", "y", "z"),
    "JointModelSphericalZYX": ("rz", "ry", "rx"),
}
# MJCF attribute of a joint -> its array in a compiled model.
DRIVE_ATTRIBUTES = {"armature": "dof_armature", "damping": "dof_damping", "frictionloss": "dof_frictionloss"}


@checked
def write_mjcf(solution: SolutionOrFile, path: str | Path) -> Path:
    """Write the model that `simulate` builds for a plan as an MJCF file; return its path.

    Args:
        solution: the plan, or the path of its file.
        path: of the file; an existing one is replaced.

    Raises:
        InputError: for a model that MJCF cannot express, a path that cannot be written, or without MuJoCo.
    """
    plan, target = require_motion(solution_of(solution)), expanded(path)
    warn_of_payloads([plan], "mjcf")
    text = mjcf_of(plan)
    with replacing(target) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    return target


def mjcf_of(plan: Solution) -> str:
    """Return the MJCF of a plan; raises `InputError`."""
    with muted_mujoco():
        return mjcf_of_scene(plan, build_scene(Site.of_plan(plan), SimulationSettings()))


def mjcf_of_scene(plan: Solution, scene: Scene) -> str:
    """Return the MJCF of a plan's model that is already built; raises `InputError`."""
    with muted_mujoco():
        root = ElementTree.fromstring(scene.bodies.spec.to_xml())
        root.set("model", str(plan.description.robot))
        for index in range(1, plan.model.njoints):
            _complete_body(root, plan.model, index)
        for joint in root.findall("worldbody//joint"):
            _complete_joint(joint, scene)
        _light_scene(root)
        _draw_bones(root, BONE * scene.units.length)
        _hold_first_grasps(root, scene)
        _add_motors(root, plan, scene)
        _add_keyframes(root, plan, scene)
        _rename(root, _names(plan))
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode")
        try:
            mujoco_package().MjModel.from_xml_string(text)
        except ValueError as error:
            raise InputError(f"MJCF cannot express the model: {first_line(error)}") from None
    return f"{text}\n"


def _numbers(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def _complete_body(root: ElementTree.Element, model: pin.Model, index: int) -> None:
    """Write the placement, inertia and axis of one joint's body."""
    body = next(one for one in root.iter("body") if one.get("name") == body_name(index))
    place, body_inertia = model.jointPlacements[index], model.inertias[index]
    body.set("pos", _numbers(place.translation))
    body.set("quat", _numbers(mujoco_quaternion(place.rotation)))
    inertia = np.array(body_inertia.inertia)
    inertia += max(LEAST - float(np.linalg.eigvalsh(inertia)[0]), 0.0) * np.eye(3)
    entries = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    inertial = next(iter(body.iter("inertial")))
    inertial.attrib.clear()
    inertial.set("pos", _numbers(body_inertia.lever))
    inertial.set("mass", _numbers(max(body_inertia.mass, LEAST)))
    inertial.set("fullinertia", _numbers(entries))
    if model.joints[index].nv == 1:
        next(iter(body.iter("joint"))).set("axis", _numbers(joint_axis(model, index)[0]))


def _complete_joint(joint: ElementTree.Element, scene: Scene) -> None:
    """Write a joint's spring, armature, damping and friction; raises `InputError` if its axes differ."""
    compiled, name = scene.compiled, str(joint.get("name"))
    number = compiled.joint(name).id
    if compiled.jnt_stiffness[number]:
        joint.set("stiffness", _numbers(compiled.jnt_stiffness[number]))
        joint.set("springref", _numbers(compiled.qpos_spring[compiled.jnt_qposadr[number]]))
    rows = compiled.dof_jntid == number
    for attribute, array in DRIVE_ATTRIBUTES.items():
        values = getattr(compiled, array)[rows]
        if np.ptp(values) > 0:
            raise InputError(f"a joint has {attribute} {values} along its axes", "allowed in MJCF: the same")
        if values[0]:
            joint.set(attribute, _numbers(values[0]))


def _light_scene(root: ElementTree.Element) -> None:
    """Add room light, a sky, and a colour of the ground that differs from the robot's."""
    visual = ElementTree.SubElement(root, "visual")
    ElementTree.SubElement(visual, "headlight", LIGHT)
    asset = root.find("asset")
    asset = ElementTree.SubElement(root, "asset") if asset is None else asset
    ElementTree.SubElement(asset, "texture", SKY | SKY_SIZE)
    for geom in root.findall("worldbody/geom"):
        geom.set("rgba", GROUND_COLOUR)
        if "." in str(geom.get("name")):
            geom.set("group", HIDDEN_GROUP)


def _draw_bones(root: ElementTree.Element, radius: float) -> None:
    """Draw a robot without shapes: a ball at each joint, and bones to its children and contacts.

    They have no mass and touch nothing.
    """
    bodies = list(root.iter("body"))
    if any(geom.get("type", "sphere") != "sphere" for body in bodies for geom in body.findall("geom")):
        return
    drawn = {"contype": "0", "conaffinity": "0", "mass": "0", "size": _numbers(radius)}
    for body in bodies:
        ends = [end.get("pos", "0 0 0") for end in (*body.findall("body"), *body.findall("site"))]
        ElementTree.SubElement(body, "geom", drawn | {"type": "sphere"})
        for end in ends:
            if np.linalg.norm(np.array(end.split(), dtype=float)) > radius:
                ElementTree.SubElement(body, "geom", drawn | {"type": "capsule", "fromto": f"0 0 0 {end}"})


def _hold_first_grasps(root: ElementTree.Element, scene: Scene) -> None:
    for grasp in scene.site.grasps:
        for held in root.findall(f"equality/*[@name='{grasp.name}']"):
            held.set("active", "true" if 0 in grasp.phases else "false")


def _add_motors(root: ElementTree.Element, plan: Solution, scene: Scene) -> None:
    """Add a motor for each torque; its ``ctrl`` is the drive torque. Raises `InputError`."""
    actuator = ElementTree.SubElement(root, "actuator")
    low, high = scene.robot.limits
    for row, name in enumerate(plan.torque_names):
        motor = ElementTree.SubElement(actuator, "motor", name=name.replace("/", "_"))
        if np.isfinite(high[row]):
            motor.set("ctrlrange", _numbers([low[row], high[row]]))
        if row >= len(plan.actuated_rows):
            thruster = plan.description.thrusters[row - len(plan.actuated_rows)]
            axis = np.array(thruster.axis) / np.linalg.norm(thruster.axis)
            motor.set("site", thruster.name)
            motor.set("gear", _numbers([*axis, *(thruster.drag * axis)]))
            continue
        place = int(plan.actuated_rows[row])
        index = next(i for i, joint in enumerate(plan.model.joints) if i and place < joint.idx_v + joint.nv)
        number = place - plan.model.joints[index].idx_v
        kind = plan.model.joints[index].shortname()
        if kind in ("JointModelFreeFlyer", "JointModelPlanar"):
            raise InputError(
                f"'{plan.model.names[index]}' has motors along axes that move with it",
                "allowed in MJCF: on hinges, slides and balls",
            )
        turns = kind == "JointModelSpherical"
        motor.set("joint", part_name(index, 0 if turns else number))
        if turns:
            motor.set("gear", _numbers([*np.eye(3)[number], 0.0, 0.0, 0.0]))


def _add_keyframes(root: ElementTree.Element, plan: Solution, scene: Scene) -> None:
    ends = plan.sample(times=plan.interval_t[[0, -1], [0, 1]])
    qpos = scene.coordinates.to_mujoco(ends.q)
    qvel = scene.coordinates.rates_to_mujoco(qpos, ends.v)
    keyframe = ElementTree.SubElement(root, "keyframe")
    for row, name in enumerate(("start", "end")):
        key = ElementTree.SubElement(keyframe, "key", name=name)
        key.set("qpos", _numbers(qpos[row]))
        key.set("qvel", _numbers(qvel[row]))
        if plan.tau.shape[1]:
            key.set("ctrl", _numbers(ends.drive_torque[row]))


def _names(plan: Solution) -> dict[str, str]:
    """Names of the robot's bodies, joints and contact frames, by their names in the specification."""
    model = plan.model
    names = {f"contact{number}": frame for number, frame in enumerate(plan.contact_frames)}
    links: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.BODY and frame.placement.isIdentity():
            links.setdefault(frame.parentJoint, frame.name)
    for index in range(1, model.njoints):
        joint = model.names[index]
        names[body_name(index)] = links.get(index, joint)
        kind = model.joints[index].shortname()
        parts = [f"{joint}_{suffix}" for suffix in PARTS.get(kind, ())] or [joint]
        names |= {part_name(index, number): part for number, part in enumerate(parts)}
    return names


def _rename(root: ElementTree.Element, names: dict[str, str]) -> None:
    for element in root.iter():
        if element.tag in ("body", "joint", "site", "motor", "weld", "connect"):
            for attribute in ("name", "joint", "joint1", "joint2", "site1", "site2"):
                if attribute in element.attrib:
                    element.set(attribute, names.get(element.attrib[attribute], element.attrib[attribute]))
