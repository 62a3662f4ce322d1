"""Limits of joints beyond those of a description: of acceleration, jerk and the rate of torque."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.arguments import UnboundedPositive, checked
from trajopt.errors import InputError, not_among, require_fields

HigherLimit = Literal["acceleration", "jerk", "torque_rate"]


@checked
@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Largest acceleration, jerk and rate of torque of a joint, inf where there is none.

    They are in rad/s^2, rad/s^3 and N m/s (or m and N). Raises InputError for a limit that is not above 0.
    """

    joint: str
    acceleration: UnboundedPositive = np.inf
    jerk: UnboundedPositive = np.inf
    torque_rate: UnboundedPositive = np.inf

    @classmethod
    def from_meta(cls, meta: Any) -> "JointLimits":
        """Limits from their description in a solution file. Raises `InputError` for a malformed one."""
        require_fields(cls, meta, "a joint's limits")
        given: dict[str, Any] = {name: np.inf if value is None else value for name, value in meta.items()}
        return cls(**given)

    def to_meta(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)


def require_joint_limits(model: pin.Model, limits: Sequence[JointLimits]) -> None:
    """Raise `InputError` for a limit of a joint that the model does not have, or for two of one joint."""
    names, known = [limit.joint for limit in limits], list(model.names)[1:]
    for name in names:
        if name not in known:
            raise not_among(known, name, f"joint '{name}' of a limit is unknown")
        if names.count(name) > 1:
            raise InputError(f"joint '{name}' has {names.count(name)} limits", "allowed: one")


def limits_by_row(model: pin.Model, limits: Sequence[JointLimits], kind: HigherLimit) -> np.ndarray:
    """The limits (nv,) of all rows, inf where there is none; joints that the model lacks are left out."""
    rows = np.full(model.nv, np.inf)
    for limit in limits:
        if model.existJointName(limit.joint):
            joint = model.joints[model.getJointId(limit.joint)]
            rows[joint.idx_v : joint.idx_v + joint.nv] = getattr(limit, kind)
    return rows
