"""A numeric model as plain numbers: the key of the cache and the input of the extension."""

import difflib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt import _pinocchio
from trajopt.dynamics.rerooting import joint_motion
from trajopt.errors import InputError, UnsupportedJointError

SUPPORTED_JOINTS = (
    "FreeFlyer", "Planar", "RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "RevoluteUnaligned",
    "RevoluteUnboundedUnaligned", "PX", "PY", "PZ", "PrismaticUnaligned", "Spherical", "SphericalZYX",
    "Translation",
)  # fmt: skip

_CLOSE_NAMES = 5
_CLOSE_CUTOFF = 0.4  # of difflib's similarity, below its default 0.6: frame names are long
_CACHED_FUNCTIONS = 64  # per decorated function


def joint_kind(model: pin.Model, index: int) -> str:
    """Kind of joint ``index`` as Pinocchio names it, without "JointModel".

    Raises ``UnsupportedJointError`` for a kind that is not in ``SUPPORTED_JOINTS``.
    """
    kind = model.joints[index].shortname().removeprefix("JointModel")
    if kind not in SUPPORTED_JOINTS:
        raise UnsupportedJointError(model.names[index], kind, ", ".join(SUPPORTED_JOINTS))
    return kind


def model_content(model: pin.Model) -> tuple:
    """Everything the algorithms read from ``model``, hashable: joints, armature, gravity.

    Raises ``UnsupportedJointError``.
    """
    joints = tuple(_joint_content(model, index) for index in range(1, model.njoints))
    return joints, tuple(model.armature.tolist()), tuple(model.gravity.linear.tolist())


@dataclass(frozen=True)
class _KeyedModel:
    """A model that compares equal to any model of the same content."""

    content: tuple
    model: pin.Model = field(compare=False)


def once_per_content(build: Callable[..., ca.Function]) -> Callable[..., ca.Function]:
    """Decorate ``build(model, *hashable)`` so that it runs once for each content of a model."""

    @lru_cache(maxsize=_CACHED_FUNCTIONS)
    def built(keyed: _KeyedModel, *arguments: object) -> ca.Function:
        return build(keyed.model, *arguments)

    @wraps(build)
    def of_model(model: pin.Model, *arguments: object) -> ca.Function:
        return built(_KeyedModel(model_content(model), model), *arguments)

    return of_model


def frame_content(model: pin.Model, name: str, wrench_size: int = 0) -> tuple:
    """Parent joint and placement of a frame, and the size of the wrench on it, hashable.

    Raises ``InputError`` that lists close names when the frame does not exist.
    """
    if not model.existFrame(name):
        known = [frame.name for frame in model.frames]
        close = difflib.get_close_matches(name, known, n=_CLOSE_NAMES, cutoff=_CLOSE_CUTOFF)
        allowed = f"close to it: {', '.join(close)}" if close else f"the frames are: {', '.join(known)}"
        raise InputError(f"the model '{model.name}' has no frame '{name}'", allowed)
    frame = model.frames[model.getFrameId(name)]
    return int(frame.parentJoint), *_placement(frame.placement), int(wrench_size)


def load_content(joint: int, place: pin.SE3) -> tuple:
    """Content of a frame at a place in a joint's axes, on which a force and a moment act, hashable."""
    return joint, *_placement(place), 6


def _joint_content(model: pin.Model, index: int) -> tuple:
    kind, axis = joint_kind(model, index), (0.0, 0.0, 0.0)
    if kind.endswith("Unaligned"):  # Pinocchio's bindings do not show the axis of every kind
        motion = joint_motion(model.joints[index])
        axis = tuple((motion.linear + motion.angular).tolist())
    inertia = model.inertias[index]
    return (
        model.names[index],
        kind,
        int(model.parents[index]),
        *_placement(model.jointPlacements[index]),
        axis,
        float(inertia.mass),
        tuple(inertia.lever.tolist()),
        tuple(np.ravel(inertia.inertia).tolist()),
    )


def _placement(placement: pin.SE3) -> tuple[tuple, tuple]:
    return tuple(np.ravel(placement.rotation).tolist()), tuple(placement.translation.tolist())


def description(content: tuple) -> _pinocchio.Description:
    """The extension's form of ``model_content``."""
    result = _pinocchio.Description()
    joints, result.armature, result.gravity = content
    result.joints = [_joint(joint) for joint in joints]
    return result


def _joint(content: tuple) -> _pinocchio.Joint:
    joint = _pinocchio.Joint()
    joint.name, joint.kind, joint.parent, joint.rotation, joint.translation, joint.axis = content[:6]
    joint.mass, joint.lever, joint.inertia = content[6:]
    return joint


def frame(content: tuple) -> _pinocchio.Frame:
    """The extension's form of ``frame_content``."""
    result = _pinocchio.Frame()
    result.joint, result.rotation, result.translation, result.wrench_size = content
    return result
