"""Robots at extremes: the same robot of another mass, size or gravity, or with other masses of some links."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from trajopt.robot.robot import Robot
from trajopt_library import problems, robots


def similar(robot: Robot, *, mass: float = 1.0, length: float = 1.0, gravity: float = 1.0) -> Robot:
    """The robot with every mass, length and its gravity multiplied: dynamically similar to itself.

    Times scale by sqrt(length / gravity), forces by mass gravity, torques by mass gravity length, and so do
    all limits. Drives are not scaled; shapes, which its files have in one size, stay only at that size.
    """
    force, time = mass * gravity, math.sqrt(length / gravity)
    linear = sliding_rows(robot.model)
    unit = np.where(linear, length, 1.0)
    model = pin.Model(robot.model)
    for joint in range(1, model.njoints):
        inertia = model.inertias[joint]
        turned = mass * length**2 * inertia.inertia
        model.inertias[joint] = pin.Inertia(mass * inertia.mass, length * inertia.lever, turned)
        model.jointPlacements[joint] = _longer(model.jointPlacements[joint], length)
    for frame in model.frames:
        frame.placement = _longer(frame.placement, length)
    model.armature = mass * np.where(linear, 1.0, length**2) * robot.model.armature
    model.gravity = pin.Motion(gravity * robot.model.gravity.linear, np.zeros(3))
    effort = None
    if robot.torque_limit is not None:
        effort = force * np.where(linear, 1.0, length)[robot.n_unactuated :] * robot.torque_limit
    soles = tuple(
        replace(contact, half_length=length * contact.half_length, half_width=length * contact.half_width)
        if contact.kind == "surface"
        else contact
        for contact in robot.contacts
    )
    given = robot.given_length
    return replace(
        robot,
        model=model,
        reference=longer(robot, robot.reference, length),
        velocity_limit=robot.velocity_limit * unit / time,
        torque_limit=effort,
        position_lower=longer(robot, robot.position_lower, length),
        position_upper=longer(robot, robot.position_upper, length),
        contacts=soles,
        given_length=None if given is None else length * given,
        visual=robot.visual if length == 1.0 else None,
    )


def longer(robot: Robot, q: np.ndarray, length: float) -> np.ndarray:
    """A configuration (..., nq) with its metres multiplied and its angles as they are."""
    model, linear = robot.model, sliding_rows(robot.model)
    scale = np.ones(model.nq)
    for joint in list(model.joints)[1:]:
        metres = int(linear[joint.idx_v : joint.idx_v + joint.nv].sum())
        scale[joint.idx_q : joint.idx_q + metres] = length
    return np.asarray(q * scale)


def sliding_rows(model: pin.Model) -> np.ndarray:
    """Which rows of v (nv,) are metres per second, by how far a motion along each turns the bodies."""
    data, linear = model.createData(), np.zeros(model.nv, dtype=bool)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for joint in range(1, model.njoints):
        rows = slice(model.joints[joint].idx_v, model.joints[joint].idx_v + model.joints[joint].nv)
        linear[rows] = ~np.any(pin.getJointJacobian(model, data, joint, pin.LOCAL)[3:, rows], axis=0)
    return linear


def _longer(placement: pin.SE3, length: float) -> pin.SE3:
    return pin.SE3(placement.rotation, length * placement.translation)


def with_gravity(robot: Robot, gravity: float) -> Robot:
    """The robot where gravity pulls down with so many m/s^2."""
    model = pin.Model(robot.model)
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    return replace(robot, model=model)


def with_armature(robot: Robot, armature: float) -> Robot:
    """The robot with this rotor inertia on every actuated joint, kg m^2."""
    model = pin.Model(robot.model)
    model.armature = np.where(np.arange(robot.nv) < robot.n_unactuated, 0.0, armature)
    return replace(robot, model=model)


def with_inertias(robot: Robot, change: Callable[[str, pin.Inertia], pin.Inertia]) -> Robot:
    """The robot with the inertia of each link, named by its joint, changed."""
    model = pin.Model(robot.model)
    for joint in range(1, model.njoints):
        model.inertias[joint] = change(model.names[joint], model.inertias[joint])
    return replace(robot, model=model)


def heavier(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    """The same body of ``factor`` times the density."""
    return pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)


def robot_file(folder: Path, kind: str, robot: str) -> str:
    """A file that builds a robot, as a user gives one: ``robot`` is an expression over ``own(name)``."""
    path = folder / "robot.py"
    tool = "TOOL = 'tool0'\n" if kind == "arm" else ""
    path.write_text(
        "import numpy as np\nimport pinocchio as pin\nfrom trajopt_library.robots import load as own\n"
        f"from tests.extremes.changed_robots import *\nKIND = {kind!r}\n{tool}"
        f"def build():\n    return {robot}\n"
    )
    return str(path)


def made(name: str, path: str):
    """The problem on the robot of a file."""
    return problems.load(name, robot=path)


def ur5() -> Robot:
    return robots.load("ur5")


def solo() -> Robot:
    return robots.load("solo12")


def limited(torque: float) -> Robot:
    """Solo12 with that largest torque in every joint, N m."""
    return replace(solo(), torque_limit=np.full(12, torque))
