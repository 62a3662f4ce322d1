"""A motion of a robot: its states, inputs and contact forces over time, and the names of their entries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import Base, base_of
from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.errors import InputError, shown
from trajopt.motion.description import PlanDescription
from trajopt.pickling import picklable
from trajopt.robot.actuators.actuation import Actuation
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import joint_force
from trajopt.robot.link_wrench import wrench_force
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.payload import loaded_model

# Order of a quaternion's entries, and axes of a moving base's velocity and acceleration.
QuaternionOrder = Literal["xyzw", "wxyz"]
BaseAxes = Literal["body", "world"]
QUATERNION_ORDERS: tuple[QuaternionOrder, ...] = ("xyzw", "wxyz")
BASE_AXES: tuple[BaseAxes, ...] = ("body", "world")
LINEAR, ANGULAR = (tuple(f"{kind}_{axis}" for axis in "xyz") for kind in ("linear", "angular"))


def require_convention(quaternion: str, base_velocity: str) -> None:
    """Raise `InputError` for an unknown quaternion order or unknown axes of the base velocity."""
    if quaternion not in QUATERNION_ORDERS:
        raise InputError(f"quaternion is {shown(quaternion)}", "allowed: 'xyzw' or 'wxyz'")
    if base_velocity not in BASE_AXES:
        raise InputError(f"base_velocity is {shown(base_velocity)}", "allowed: 'body' or 'world'")


def position_names(model: pin.Model, quaternion: QuaternionOrder = "xyzw") -> tuple[str, ...]:
    """Return names (nq,) of the entries of q: the joint, with the entry if the joint has several."""
    turn = tuple(f"q{entry}" for entry in quaternion)
    entries = {
        "freeflyer": ("x", "y", "z", *turn),
        "spherical": turn,
        "planar": ("x", "y", "cos", "sin"),
        "continuous": ("cos", "sin"),
    }
    return _named(model, lambda joint: entries.get(joint.kind) or _plain(model, joint))


def velocity_names(model: pin.Model, base_velocity: BaseAxes = "body") -> tuple[str, ...]:
    """Return names (nv,) of the entries of v; those along body or world axes end with "body" or "world"."""

    def entries(joint: Joint) -> tuple[str, ...]:
        axes = base_velocity if is_base(model, joint) else "body"
        linear, angular = ([f"{entry}_{axes}" for entry in part] for part in (LINEAR, ANGULAR))
        if joint.kind == "planar":
            return (*linear[:2], ANGULAR[2])
        parts = {"freeflyer": (*linear, *angular), "spherical": tuple(angular)}
        return parts.get(joint.kind) or _plain(model, joint)

    return _named(model, entries)


def is_base(model: pin.Model, joint: Joint) -> bool:
    """Return whether a joint is the base: the first joint, if it is a free-flyer or planar."""
    return joint.kind in ("freeflyer", "planar") and model.names[1] == joint.name


def _plain(model: pin.Model, joint: Joint) -> tuple[str, ...]:
    if joint.v.stop - joint.v.start == 1:
        return ("",)
    turns = model.joints[model.getJointId(joint.name)].shortname() == "JointModelSphericalZYX"
    return ("rz", "ry", "rx") if turns else ("x", "y", "z")


def _named(model: pin.Model, entries: Callable[[Joint], tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(
        f"{joint.name}/{entry}" if entry else joint.name
        for joint in Coordinates(model).joints
        for entry in entries(joint)
    )


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class RobotMotion:
    """A robot's motion at K times, SI units: what a `Solution` and a `SampledMotion` have in common.

    description: the plan: names, contacts, limits, ground, goals, payloads, shapes.
    model: the model that was optimised.
    t: (K,) s. phase: (K,) index.
    q, v, a: (K, nq), (K, nv), (K, nv) in Pinocchio's convention.
    tau: (K, nu) torques of the actuated rows, and forces of thrusters after them.
    f: (K, nc, 6) force N and moment N m of the environment on the robot, world-aligned axes at
        the contact frame's origin; zero when inactive. Payloads are in ``description.payloads``.
    active: (K, nc) whether the contact is active.
    """

    description: PlanDescription = field(repr=False)
    model: pin.Model = field(repr=False)
    t: np.ndarray
    phase: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    f: np.ndarray
    active: np.ndarray

    @property
    def contact_frames(self) -> tuple[str, ...]:
        """Frames of the contacts, in the order of ``f`` and ``active``."""
        return self.description.frames

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts, in the same order; for files without names, their frames."""
        return tuple(contact.name for contact in self.description.contacts)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints of the model in Pinocchio's order, including a moving base."""
        return tuple(self.model.names)[1:]

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Frames of the model in Pinocchio's order."""
        return tuple(frame.name for frame in self.model.frames)

    @property
    def position_names(self) -> tuple[str, ...]:
        """Names (nq,) of the entries of ``q``: the joint, with the entry if several (``root_joint/qx``)."""
        return position_names(self.model)

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names (nv,) of the entries of ``v`` and ``a``; a moving base is along its body axes."""
        return velocity_names(self.model)

    @property
    def torque_names(self) -> tuple[str, ...]:
        """Names (nu,) of the entries of ``tau``."""
        names = velocity_names(self.model)
        thrusters = (thruster.name for thruster in self.description.thrusters)
        return (*(names[row] for row in self.actuated_rows), *thrusters)

    @cached_property
    def actuated_rows(self) -> np.ndarray:
        """Rows of v with a torque, in the order of ``tau``, where thruster forces come after them."""
        rows = self.description.actuated_rows
        nv, joints = self.v.shape[1], self.tau.shape[1] - len(self.description.thrusters)
        return np.arange(nv - joints, nv) if rows is None else rows

    @cached_property
    def unactuated_rows(self) -> np.ndarray:
        """Rows of v without torque: those of a moving base, which come first, and passive joints."""
        return np.setdiff1d(np.arange(self.v.shape[1]), self.actuated_rows)

    @cached_property
    def actuation(self) -> Actuation:
        """Map from ``tau`` to generalised forces."""
        unit = self.units.generalized_force(self.model)
        return Actuation.of(
            self.model, self.actuated_rows, self.description.thrusters, self.description.mimics, unit
        )

    def known_force(self, t: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return forces (..., nv) of joint springs, damping, friction and known wrenches at t (...) s."""
        own = joint_force(self.model, self.description.joint_forces, q, v)
        return own + wrench_force(self.model, self.description.wrenches, t, q)

    @property
    def n_unactuated(self) -> int:
        """Number of rows without torque."""
        return len(self.unactuated_rows)

    @property
    def drives(self) -> tuple[Drive | None, ...]:
        """Drive of each actuated row (nu,), None where there is none."""
        return self.description.drives or (None,) * self.tau.shape[1]

    @property
    def base(self) -> Base:
        """Kind of the model's base."""
        return base_of(self.model)

    @cached_property
    def units(self) -> NaturalUnits:
        """Natural units of the model."""
        return NaturalUnits.of(self.model)

    @cached_property
    def contact_ids(self) -> list[int]:
        """Indices of the contacts' frames in the model."""
        return [int(self.model.getFrameId(frame)) for frame in self.contact_frames]

    def carrying_model(self, phase: int) -> pin.Model:
        """Return the model with everything that the robot carries in a phase."""
        model = self.model
        for body in self.description.carried_in(phase):
            model = loaded_model(model, body.frame, body.spatial)
        return model
