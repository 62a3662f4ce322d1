"""Models of the lectures' examples: arms of three joints, the planar hopper, a robot on virtual joints."""

from functools import lru_cache

import numpy as np
import pinocchio as pin

from tests.support.models import ROBOTS, hand_built, random_state, robot
from trajopt.robot.data import robot_file
from trajopt.robot.reading import read_urdf

THIGH, SHANK = 0.35, 0.3  # m
HALF_TORSO = 0.15  # m
VIRTUAL_BASE = "base_rx"
# Where the base is not the root joint; and the number of base rows.
BASE_JOINTS = {"virtual:solo12": VIRTUAL_BASE, "planar_hopper": "pitch"}
BASE_SIZES = {"solo12": 6, "talos": 6, "planar:go2": 3, "virtual:solo12": 6, "planar_hopper": 3, "ur5": 0}
FLOATING = ("solo12", "talos", "planar:go2", "virtual:solo12", "planar_hopper")
FIXED = ("ur5", "panda", "kinova", "three_joint_arm")


def _at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def _add(model: pin.Model, parent: int, joint: pin.JointModel, place: pin.SE3, name: str) -> int:
    index = model.addJoint(parent, joint, place, name)
    model.addJointFrame(index, -1)
    return index


@lru_cache
def three_joint_arm() -> pin.Model:
    """Waist about z, shoulder and elbow about y; links with full inertia tensors; rotors."""
    model = pin.Model()
    model.name = "three joint arm"
    waist = _add(model, 0, pin.JointModelRZ(), _at(z=0.3), "waist")
    shoulder = _add(model, waist, pin.JointModelRY(), _at(x=0.1, z=0.2), "shoulder")
    elbow = _add(model, shoulder, pin.JointModelRY(), _at(x=0.5, y=0.05), "elbow")
    for index, mass in ((waist, 8.0), (shoulder, 4.0), (elbow, 2.0)):
        tensor = pin.Inertia.FromBox(mass, 0.3, 0.2, 0.1).inertia
        turned = pin.exp3(np.array([0.2, -0.1, 0.3]))
        inertia = pin.Inertia(mass, np.array([0.2, 0.01, -0.03]), turned @ tensor @ turned.T)
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.armature[:] = [0.3, 0.2, 0.1]
    return model


@lru_cache
def planar_hopper() -> pin.Model:
    """Torso, hip and knee in the x-z plane; the torso moves on virtual joints x, z and pitch."""
    model = pin.Model()
    model.name = "planar hopper"
    x = _add(model, 0, pin.JointModelPX(), _at(), "x")
    z = _add(model, x, pin.JointModelPZ(), _at(), "z")
    torso = _add(model, z, pin.JointModelRY(), _at(), "pitch")
    hip = _add(model, torso, pin.JointModelRY(), _at(z=-HALF_TORSO), "hip")
    knee = _add(model, hip, pin.JointModelRY(), _at(z=-THIGH), "knee")
    model.appendBodyToJoint(torso, pin.Inertia.FromBox(6.0, 0.3, 0.2, 2 * HALF_TORSO), _at(x=0.02))
    model.appendBodyToJoint(hip, pin.Inertia.FromBox(1.5, 0.06, 0.06, THIGH), _at(z=-THIGH / 2))
    model.appendBodyToJoint(knee, pin.Inertia.FromBox(0.8, 0.04, 0.04, SHANK), _at(z=-SHANK / 2))
    model.addFrame(pin.Frame("foot", knee, 0, _at(z=-SHANK), pin.OP_FRAME))
    model.armature[3:] = 0.01
    return model


def on_virtual_joints(model: pin.Model) -> pin.Model:
    """The free-flying ``model`` with its root as three prismatic and three revolute joints (z, y, x)."""
    chain = pin.Model()
    parent = 0
    for kind in ("PX", "PY", "PZ", "RZ", "RY", "RX"):
        joint = getattr(pin, f"JointModel{kind}")()
        parent = _add(chain, parent, joint, pin.SE3.Identity(), f"base_{kind.lower()}")
    chain.appendBodyToJoint(parent, model.inertias[1], pin.SE3.Identity())
    for index in range(2, model.njoints):
        above = model.parents[index] + 5
        _add(chain, above, model.joints[index], model.jointPlacements[index], model.names[index])
        chain.appendBodyToJoint(index + 5, model.inertias[index], pin.SE3.Identity())
    for frame in model.frames:
        if frame.parentJoint > 0 and not chain.existFrame(frame.name):
            chain.addFrame(pin.Frame(frame.name, frame.parentJoint + 5, 0, frame.placement, pin.OP_FRAME))
    chain.armature[:] = model.armature
    chain.name = f"{model.name} on virtual joints"
    return chain


def link_momentum_matrix(model: pin.Model, q: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Momentum per rate (6, nv) of all links about a point, world axes: from Jacobians of their centres."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    total = np.zeros((6, model.nv))
    for index in range(1, model.njoints):
        inertia, place = model.inertias[index], data.oMi[index]
        jacobian = pin.getJointJacobian(model, data, index, pin.LOCAL_WORLD_ALIGNED)
        arm = place.rotation @ inertia.lever
        linear = inertia.mass * (jacobian[:3] - pin.skew(arm) @ jacobian[3:])
        spin = place.rotation @ inertia.inertia @ place.rotation.T @ jacobian[3:]
        total += np.vstack([linear, spin + pin.skew(place.translation + arm - about) @ linear])
    return total


@lru_cache
def named(name: str) -> pin.Model:
    """A model by name: a robot, ``joint:<kind>``, ``planar:go2`` in the sagittal plane, or one of these."""
    if name == "planar:go2":
        return read_urdf(robot_file("go2_description/urdf/go2.urdf"), "planar")
    if name == "virtual:solo12":
        return on_virtual_joints(robot("solo12")[0])
    if name == "talos_legs":
        model = robot("talos")[0]
        locked = [name for name in model.names if name.startswith(("arm", "torso", "head", "gripper"))]
        return pin.buildReducedModel(
            model, [model.getJointId(joint) for joint in locked], random_state(model, 5)[0]
        )
    if name in ROBOTS:
        return robot(name)[0]
    if name.startswith("joint:"):
        return hand_built(name.removeprefix("joint:"))[0]
    return {"three_joint_arm": three_joint_arm, "planar_hopper": planar_hopper}[name]()
