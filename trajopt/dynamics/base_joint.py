"""Kinds of base: their recognition in a model, rows and coordinates; position limits of a model.

A base is fixed, a free-flyer, planar, or virtual: six joints in series, three prismatic along x, y, z, and
three revolute about axes in one of ``ORDERS`` (see `virtual_base`).
"""

from typing import Literal

import numpy as np
import pinocchio as pin

Base = Literal["freeflyer", "virtual", "planar", "fixed"]
BASE_ROWS: dict[Base, int] = {"freeflyer": 6, "virtual": 6, "planar": 3, "fixed": 0}
BASE_COORDINATES: dict[Base, int] = {"freeflyer": 7, "virtual": 6, "planar": 4, "fixed": 0}
# The joint that carries the base link: the last of the virtual ones.
BASE_JOINT: dict[Base, int] = {"freeflyer": 1, "virtual": 6, "planar": 1, "fixed": 0}
# Number of leading entries of q that are the position of the base.
BASE_POSITION: dict[Base, int] = {"freeflyer": 3, "virtual": 3, "planar": 2, "fixed": 0}
# Parsers write "no limit" as the largest double or as infinity; no robot reaches this.
UNLIMITED = 1e20
# A virtual base: the world's axes, orders of its revolute joints, prefix of joint names, number of rows.
AXES = "XYZ"
ORDERS = ("ZYX", "ZXY", "YXZ", "YZX", "XYZ", "XZY")
PREFIX = "virtual_"
ROWS = 6


def base_of(model: pin.Model) -> Base:
    """Kind of base of a model, read from its first joint, or its first six for a virtual base."""
    if model.njoints < 2:
        return "fixed"
    if virtual_order(model) is not None:
        return "virtual"
    kinds: dict[str, Base] = {"JointModelFreeFlyer": "freeflyer", "JointModelPlanar": "planar"}
    return kinds.get(model.joints[1].shortname(), "fixed")


def position_limits(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper position limits (nq,); -inf and inf where a coordinate has none.

    Quaternions and (cos, sin) pairs are coordinates of a manifold and have no limits.
    """
    lower = np.where(np.abs(model.lowerPositionLimit) > UNLIMITED, -np.inf, model.lowerPositionLimit)
    upper = np.where(np.abs(model.upperPositionLimit) > UNLIMITED, np.inf, model.upperPositionLimit)
    for joint in list(model.joints)[1:]:
        if joint.nq != joint.nv:
            lower[joint.idx_q : joint.idx_q + joint.nq] = -np.inf
            upper[joint.idx_q : joint.idx_q + joint.nq] = np.inf
    return lower, upper


def virtual_order(model: pin.Model) -> str | None:
    """Order of the revolute joints of a virtual base, such as "ZYX"; None for another base."""
    if model.njoints <= ROWS or not model.names[1].startswith(PREFIX):
        return None
    names = list(model.names)[1 : ROWS + 1]
    kinds = "".join(model.joints[i].shortname().removeprefix("JointModel") for i in range(1, ROWS + 1))
    order = kinds[7::2]
    serial = list(model.parents)[1 : ROWS + 1] == list(range(ROWS))
    named = names == virtual_joint_names(order)
    return order if serial and named and order in ORDERS and kinds == _kinds(order) else None


def _kinds(order: str) -> str:
    return "PXPYPZ" + "".join(f"R{axis}" for axis in order)


def virtual_joint_names(order: str) -> list[str]:
    """Names of the six joints of a virtual base."""
    return [f"{PREFIX}p{axis.lower()}" for axis in AXES] + [f"{PREFIX}r{axis.lower()}" for axis in order]
