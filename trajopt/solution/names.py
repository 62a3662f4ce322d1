"""Names of the entries of q, v and tau of a model, in Pinocchio's order."""

from collections.abc import Callable
from typing import Literal

import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.errors import InputError, shown

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
