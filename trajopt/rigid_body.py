"""Pinocchio's algorithms as CasADi functions of a numeric model."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin
from casadi import Function

from trajopt import _pinocchio
from trajopt.errors import InputError, UnsupportedJointError

SUPPORTED_JOINTS = (
    "FreeFlyer", "Planar", "RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "RevoluteUnaligned",
    "RevoluteUnboundedUnaligned", "PX", "PY", "PZ", "PrismaticUnaligned", "Spherical", "SphericalZYX",
    "Translation",
)  # fmt: skip
WRENCH_SIZES = (0, 3, 6)

NO_AXIS = (0.0, 0.0, 0.0)


def fused(model: pin.Model, frames: Sequence[str], wrench_kinds: Sequence[int]) -> Function:
    """Inverse dynamics under wrenches and the motion of frames, sharing one forward pass.

    ``(q, v, a, w) -> (tau, rotation, position, velocity, acceleration)`` where

    - ``w`` stacks, for each frame, its wrench of size 0 (none), 3 (force) or 6 (force, moment):
      N and Nm on the robot, world-aligned axes, at the frame's origin;
    - ``tau`` (nv) is ``RNEA(q, v, a) - sum J^T w``, gravity included;
    - the other outputs have one column a frame: ``rotation`` (9, column-major) and ``position`` (3)
      in the world; ``velocity`` (6: linear, angular) and ``acceleration`` (6: classical linear,
      angular) in world-aligned axes at the frame's origin.

    Raises ``InputError`` for a frame that does not exist and ``UnsupportedJointError``.
    """
    if len(frames) != len(wrench_kinds) or not set(wrench_kinds) <= set(WRENCH_SIZES):
        raise InputError(f"wrench sizes {list(wrench_kinds)} for frames {list(frames)}", "one of 0, 3, 6 a frame")
    described = tuple(
        (*frame_content(model, name), int(size)) for name, size in zip(frames, wrench_kinds, strict=True)
    )
    return _fused(model_content(model), described)


@lru_cache(maxsize=64)
def _fused(content: tuple, frames: tuple) -> Function:
    return Function.deserialize(_pinocchio.fused(_description(content), [_frame(frame) for frame in frames]))


def frame_content(model: pin.Model, name: str) -> tuple:
    """Parent joint and placement of a frame as plain numbers."""
    if not model.existFrame(name):
        known = [frame.name for frame in model.frames]
        close = difflib.get_close_matches(name, known, n=5, cutoff=0.4)
        raise InputError(f"the model '{model.name}' has no frame '{name}'", f"close: {', '.join(close or known[:10])}")
    frame = model.frames[model.getFrameId(name)]
    return frame.parentJoint, *_placement(frame.placement)


def model_content(model: pin.Model) -> tuple:
    """Everything the algorithms read from a model, as hashable plain numbers."""
    joints = tuple(_joint_content(model, index) for index in range(1, model.njoints))
    return joints, tuple(model.armature.tolist()), tuple(model.gravity.linear.tolist())


def _joint_content(model: pin.Model, index: int) -> tuple:
    joint = model.joints[index]
    kind = joint.shortname().removeprefix("JointModel")
    if kind not in SUPPORTED_JOINTS:
        raise UnsupportedJointError(model.names[index], kind, ", ".join(SUPPORTED_JOINTS))
    axis = tuple(joint.extract().axis.tolist()) if kind.endswith("Unaligned") else NO_AXIS
    inertia = model.inertias[index]
    return (
        model.names[index], kind, int(model.parents[index]), *_placement(model.jointPlacements[index]), axis,
        float(inertia.mass), tuple(inertia.lever.tolist()), tuple(np.ravel(inertia.inertia).tolist()),
    )  # fmt: skip


def _placement(placement: pin.SE3) -> tuple[tuple, tuple]:
    return tuple(np.ravel(placement.rotation).tolist()), tuple(placement.translation.tolist())


def _description(content: tuple) -> _pinocchio.Description:
    description = _pinocchio.Description()
    joints, description.armature, description.gravity = content
    description.joints = [_joint(joint) for joint in joints]
    return description


def _joint(content: tuple) -> _pinocchio.Joint:
    joint = _pinocchio.Joint()
    (
        joint.name, joint.kind, joint.parent, joint.rotation, joint.translation, joint.axis,
        joint.mass, joint.lever, joint.inertia,
    ) = content  # fmt: skip
    return joint


def _frame(content: tuple) -> _pinocchio.Frame:
    frame = _pinocchio.Frame()
    frame.joint, frame.rotation, frame.translation, frame.wrench_size = content
    return frame
