"""Pinocchio's algorithms as CasADi functions of a numeric model.

Every function takes a ``pin.Model`` (built or edited by any means; lock joints by passing the reduced model)
and returns a ``casadi.Function`` of SX, built once per model content, in Pinocchio's conventions:
configuration q (nq), velocity v (nv) and acceleration a (nv), SI units. All of them raise
``UnsupportedJointError`` for an unsupported joint, and those that take a frame raise ``InputError`` for a
name that the model does not have.

``reference`` is Pinocchio's reference frame of a motion: "world_aligned" (world axes at the frame's
origin), "local" (the frame's axes and origin) or "world" (spatial, at the world's origin).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, get_args

import casadi as ca
import pinocchio as pin
from casadi import Function

from trajopt import _pinocchio
from trajopt.arguments import checked
from trajopt.dynamics import configuration_space
from trajopt.dynamics.model_content import description, frame, frame_content, joint_kind, model_content
from trajopt.errors import InputError

Reference = Literal["world_aligned", "local", "world"]

WRENCH_SIZES = (0, 3, 6)
_CACHED_FUNCTIONS = 256


def fused(
    model: pin.Model, frames: Sequence[str], wrench_kinds: Sequence[int], loads: tuple = ()
) -> Function:
    """Inverse dynamics under wrenches and the motion of frames, sharing one forward pass.

    ``(q, v, a, w) -> (tau, rotation, position, velocity, acceleration)`` where

    - ``w`` stacks, for each frame, its wrench of size 0 (none), 3 (force) or 6 (force, moment):
      N and Nm on the robot, world-aligned axes, at the frame's origin;
    - ``tau`` (nv) is ``RNEA(q, v, a) - sum J^T w``, the model's gravity included;
    - the other outputs have one column per frame: ``rotation`` (9, column-major) and ``position`` (3)
      in the world; ``velocity`` (6: linear, angular) and ``acceleration`` (6: classical linear,
      angular) in world-aligned axes at the frame's origin.

    ``loads`` are further frames with force and moment, by `load_content`; they come last.
    """
    return _fused(model_content(model), (*loaded_frames(model, frames, wrench_kinds), *loads))


def loaded_frames(model: pin.Model, frames: Sequence[str], wrench_kinds: Sequence[int]) -> tuple:
    """Contents of frames with the sizes of their wrenches. Raises `InputError` for an unknown size."""
    if len(frames) != len(wrench_kinds) or not set(wrench_kinds) <= set(WRENCH_SIZES):
        what = f"wrench sizes {list(wrench_kinds)} for frames {list(frames)}"
        raise InputError(what, "one of 0, 3, 6 per frame")
    pairs = zip(frames, wrench_kinds, strict=True)
    return tuple(frame_content(model, name, size) for name, size in pairs)


@checked
def rnea(model: pin.Model) -> Function:
    """Inverse dynamics ``(q, v, a) -> tau`` (nv; N, Nm), armature and gravity included."""
    return _of_model("rnea", model_content(model))


@checked
def bias_forces(model: pin.Model) -> Function:
    """Coriolis, centrifugal and gravity terms ``(q, v) -> h`` (nv; N, Nm)."""
    return _of_model("bias_forces", model_content(model))


@checked
def mass_matrix(model: pin.Model) -> Function:
    """Joint-space inertia ``q -> M`` (nv, nv), symmetric, armature included."""
    return _of_model("mass_matrix", model_content(model))


@checked
def frame_placement(model: pin.Model, frame_name: str) -> Function:
    """Placement in the world ``q -> (rotation (3, 3), position (3) in m)``."""
    return _of_frame("frame_placement", model_content(model), frame_content(model, frame_name))


def frame_velocity(model: pin.Model, frame_name: str, reference: Reference = "world_aligned") -> Function:
    """Velocity ``(q, v) -> velocity`` (6: linear m/s, angular rad/s)."""
    return _in_reference("frame_velocity", model, frame_name, reference)


@checked
def frame_acceleration(model: pin.Model, frame_name: str, reference: Reference = "world_aligned") -> Function:
    """Acceleration ``(q, v, a) -> acceleration`` (6: classical linear m/s^2, angular rad/s^2).

    Without gravity. In the reference "world" the linear part is Pinocchio's: the spatial one plus
    ``omega x v`` at the world's origin.
    """
    return _in_reference("frame_acceleration", model, frame_name, reference)


@checked
def frame_jacobian(model: pin.Model, frame_name: str, reference: Reference = "world_aligned") -> Function:
    """Jacobian ``q -> J`` (6, nv) of the frame's velocity, which is ``J v``."""
    return _frame_jacobian(frame_velocity(model, frame_name, reference))


def centre_of_mass(model: pin.Model) -> Function:
    """Centre of mass ``(q, v) -> (c, dc)`` (3, m; 3, m/s) in the world."""
    return _of_model("centre_of_mass", model_content(model))


def centroidal_momentum(model: pin.Model) -> Function:
    """Momentum ``(q, v) -> h`` (6: linear, angular about the centre of mass), world axes."""
    return _of_model("centroidal_momentum", model_content(model))


def centroidal_momentum_rate(model: pin.Model) -> Function:
    """Momentum and its rate ``(q, v, a) -> (h, dh)`` (6 each), about the centre of mass, world axes."""
    return _of_model("centroidal_momentum_rate", model_content(model))


def kinetic_energy(model: pin.Model) -> Function:
    """Kinetic energy ``(q, v) -> energy`` (J), armature included."""
    return _kinetic_energy(model_content(model))


def potential_energy(model: pin.Model) -> Function:
    """Potential energy of gravity ``q -> energy`` (J), zero at the world's origin."""
    return _of_model("potential_energy", model_content(model))


def integrate(model: pin.Model) -> Function:
    """Configuration reached in unit time at constant velocity, ``(q, v) -> q_next`` (nq).

    Smooth at v = 0 in value and derivatives.
    """
    return configuration_space.integrate_function(_kinds(model))


def difference(model: pin.Model) -> Function:
    """The velocity that leads from one configuration to the other in unit time, ``(q0, q1) -> v`` (nv).

    Smooth at q0 = q1 in value and derivatives; rotations take the shorter way, which is undefined at pi rad.
    """
    return configuration_space.difference_function(_kinds(model))


def _kinds(model: pin.Model) -> tuple[str, ...]:
    return tuple(joint_kind(model, index) for index in range(1, model.njoints))


def _in_reference(name: str, model: pin.Model, frame_name: str, reference: str) -> Function:
    if reference not in get_args(Reference):
        raise InputError(f"reference '{reference}'", f"one of {', '.join(get_args(Reference))}")
    return _of_frame(name, model_content(model), frame_content(model, frame_name), reference)


@lru_cache(maxsize=_CACHED_FUNCTIONS)
def _kinetic_energy(model: tuple) -> Function:
    """Kinetic energy of links and rotors."""
    links = _of_model("kinetic_energy", model)
    q, v = links.sx_in(0), links.sx_in(1)
    rotors = ca.dot(ca.DM(model[1]), v**2) / 2
    return Function("kinetic_energy", [q, v], [links(q, v) + rotors], ["q", "v"], ["energy"])


@lru_cache(maxsize=_CACHED_FUNCTIONS)
def _frame_jacobian(velocity: Function) -> Function:
    q, v = velocity.sx_in()
    return Function("frame_jacobian", [q], [ca.densify(ca.jacobian(velocity(q, v), v))], ["q"], ["J"])


@lru_cache(maxsize=_CACHED_FUNCTIONS)
def _of_model(name: str, model: tuple) -> Function:
    return Function.deserialize(getattr(_pinocchio, name)(description(model)))


@lru_cache(maxsize=_CACHED_FUNCTIONS)
def _of_frame(name: str, model: tuple, at: tuple, *reference: str) -> Function:
    return Function.deserialize(getattr(_pinocchio, name)(description(model), frame(at), *reference))


@lru_cache(maxsize=_CACHED_FUNCTIONS)
def _fused(model: tuple, frames: tuple) -> Function:
    return Function.deserialize(_pinocchio.fused(description(model), [frame(at) for at in frames]))
