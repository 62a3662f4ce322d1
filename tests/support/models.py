"""Numeric models for tests: robots of example-robot-data and models of every kind of joint."""

import importlib.metadata
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin

FREE, FIXED, PLANAR = pin.JointModelFreeFlyer, None, pin.JointModelPlanar

# name: file in example-robot-data's "robots", base joint, a frame far from the base
ROBOTS = {
    "solo12": ("solo_description/robots/solo12.urdf", FREE, "HR_FOOT"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", FIXED, "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", FIXED, "panda_hand"),
    "talos": ("talos_data/robots/talos_reduced.urdf", FREE, "left_sole_link"),
    "anymal_c": ("anymal_c_simple_description/urdf/anymal.urdf", FREE, "RH_FOOT"),
    "kinova": ("kinova_description/robots/kinova.urdf", FIXED, "j2s6s200_end_effector"),
    "go2_planar": ("go2_description/urdf/go2.urdf", PLANAR, "FL_foot"),
    "double_pendulum": ("double_pendulum_description/urdf/double_pendulum_continuous.urdf", FIXED, "link2"),
}

_JOINTS = {
    "FreeFlyer": pin.JointModelFreeFlyer,
    "Planar": pin.JointModelPlanar,
    "RX": pin.JointModelRX,
    "RY": pin.JointModelRY,
    "RZ": pin.JointModelRZ,
    "RUBX": pin.JointModelRUBX,
    "RUBY": pin.JointModelRUBY,
    "RUBZ": pin.JointModelRUBZ,
    "RevoluteUnaligned": lambda: pin.JointModelRevoluteUnaligned(*_AXIS),
    "RevoluteUnboundedUnaligned": lambda: _continuous_joint(),
    "PX": pin.JointModelPX,
    "PY": pin.JointModelPY,
    "PZ": pin.JointModelPZ,
    "PrismaticUnaligned": lambda: pin.JointModelPrismaticUnaligned(*_AXIS),
    "Spherical": pin.JointModelSpherical,
    "SphericalZYX": pin.JointModelSphericalZYX,
    "Translation": pin.JointModelTranslation,
}
_AXIS = np.array([2.0, -3.0, 6.0]) / 7.0
JOINT_KINDS = tuple(_JOINTS)
TIP = "tip"


@lru_cache
def robot(name: str) -> tuple[pin.Model, str]:
    """The model of a robot of ``ROBOTS`` with armature on its joints, and its frame."""
    file, base, frame = ROBOTS[name]
    robots = importlib.metadata.distribution("example-robot-data").locate_file(
        "cmeel.prefix/share/example-robot-data/robots"
    )
    path = str(Path(str(robots)) / file)
    model = pin.buildModelFromUrdf(path, base()) if base else pin.buildModelFromUrdf(path)
    generator = np.random.default_rng(0)
    base_nv = model.joints[1].nv if base else 0
    model.armature[base_nv:] = generator.uniform(0.01, 0.1, model.nv - base_nv)
    return model, frame


@lru_cache
def hand_built(kind: str) -> tuple[pin.Model, str]:
    """A tree of three bodies: a revolute joint, a joint of ``kind`` on it, and a branch; armature."""
    generator = np.random.default_rng(1)
    model = pin.Model()
    model.name = kind
    first = model.addJoint(0, pin.JointModelRY(), _placement(generator), "first")
    middle = model.addJoint(first, _JOINTS[kind](), _placement(generator), kind)
    branch = model.addJoint(middle, pin.JointModelRX(), _placement(generator), "branch")
    for joint in (first, middle, branch):
        model.appendBodyToJoint(joint, _inertia(generator), pin.SE3.Identity())
    model.addFrame(pin.Frame(TIP, middle, 0, _placement(generator), pin.OP_FRAME))
    model.armature[:] = generator.uniform(0.1, 1.0, model.nv)
    return model, TIP


def random_state(model: pin.Model, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configuration and two tangent vectors, each entry within one unit of neutral."""
    generator = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), generator.uniform(-1, 1, model.nv))
    return q, generator.uniform(-1, 1, model.nv), generator.uniform(-1, 1, model.nv)


def _continuous_joint() -> pin.JointModel:
    """A continuous joint about ``_AXIS``: Python's bindings make one only out of a URDF."""
    axis = " ".join(str(value) for value in _AXIS)
    urdf = f"""<robot name="continuous"><link name="base"/><link name="body"/>
        <joint name="joint" type="continuous">
        <parent link="base"/><child link="body"/><axis xyz="{axis}"/>
        </joint></robot>"""
    return pin.buildModelFromXML(urdf).joints[1]


def _placement(generator: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(generator.uniform(-1, 1, 3)), generator.uniform(-0.5, 0.5, 3))


def _inertia(generator: np.random.Generator) -> pin.Inertia:
    shape = generator.uniform(-1, 1, (3, 3))
    return pin.Inertia(generator.uniform(1, 2), generator.uniform(-0.2, 0.2, 3), shape @ shape.T + np.eye(3))


def placement(model: pin.Model, q: np.ndarray, frame: str) -> pin.SE3:
    """Pose of a frame in the world by numeric Pinocchio."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)].copy()
