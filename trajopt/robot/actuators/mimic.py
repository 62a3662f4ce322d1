"""Mimic joints: followers that move with a leader, such as a gripper's second finger or coupled axes.

    q_j = r q_i + c,      v = E y with the independent rates y,      E^T (M a + h - S^T tau - J^T f) = 0

The force that couples the joints does no work (Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 3.2).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.errors import InputError, UnsupportedJointError, require_fields


@checked
@dataclass(frozen=True, kw_only=True)
class MimicJoint:
    """A follower and its leader, both joints of one coordinate.

    Args:
        joint: name of the follower.
        mimics: name of the leader, which follows no other joint.
        ratio: r, ratio of their positions and rates.
        offset: c, rad or m.
    """

    joint: str
    mimics: str
    ratio: float = 1.0
    offset: float = 0.0

    @classmethod
    def from_meta(cls, meta: Any) -> "MimicJoint":
        """Mimic joint from its description in a solution file. Raises `InputError` for a malformed one."""
        require_fields(cls, meta, "a mimic joint")
        return cls(**meta)

    def to_meta(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)

    def joints(self, model: pin.Model) -> tuple[Any, Any]:
        """Pinocchio's joints of the follower and its leader. Raises `InputError`."""
        for name in (self.joint, self.mimics):
            if not model.existJointName(name):
                known = ", ".join(list(model.names)[1:])
                raise InputError(f"joint '{name}' of a mimic joint is unknown", f"one of {known}")
            joint = model.joints[model.getJointId(name)]
            if joint.nq != 1 or joint.nv != 1:
                raise UnsupportedJointError(name, joint.shortname(), "mimic joints of one coordinate")
        return tuple(model.joints[model.getJointId(name)] for name in (self.joint, self.mimics))

    def swapped(self) -> "MimicJoint":
        """The same rule with leader and follower swapped; the ratio must not be 0."""
        return MimicJoint(
            joint=self.mimics,
            mimics=self.joint,
            ratio=1 / self.ratio,
            offset=(0.0 - self.offset) / self.ratio,
        )

    def apart(self, model: pin.Model, q: np.ndarray) -> np.ndarray:
        """Error q_j - r q_i - c (...,) of the rule at configurations (..., nq), rad or m."""
        joint, leader = self.joints(model)
        return np.asarray(q[..., joint.idx_q] - self.ratio * q[..., leader.idx_q] - self.offset)


def require_mimics(robot: str, model: pin.Model, mimics: Sequence[MimicJoint]) -> None:
    """Raise `InputError` for a joint that follows two leaders, itself, or another follower."""
    followers = [mimic.joint for mimic in mimics]
    for mimic in mimics:
        mimic.joints(model)
        if followers.count(mimic.joint) > 1 or mimic.mimics in followers:
            raise InputError(
                f"'{mimic.joint}' of robot '{robot}' mimics '{mimic.mimics}'",
                "allowed: each joint once, after one that follows no other",
            )


def followed(model: pin.Model, mimics: Sequence[MimicJoint], q: np.ndarray) -> np.ndarray:
    """The configuration ``q`` (nq,) with every follower set from its leader."""
    q = np.array(q, dtype=float)
    for mimic in mimics:
        joint, leader = mimic.joints(model)
        q[joint.idx_q] = mimic.ratio * q[leader.idx_q] + mimic.offset
    return q


def independent_rates(model: pin.Model, mimics: Sequence[MimicJoint]) -> np.ndarray:
    """E (nv, ny) of v = E y, with a column for each row of v that follows no other."""
    whole = np.eye(model.nv)
    rows = []
    for mimic in mimics:
        joint, leader = mimic.joints(model)
        whole[joint.idx_v, leader.idx_v] = mimic.ratio
        rows.append(joint.idx_v)
    return np.delete(whole, rows, axis=1)
