"""Reductions that lock joints and drop contacts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from trajopt.dynamics.base_joint import BASE_COORDINATES
from trajopt.robot.robot import Robot
from trajopt.scenes.reduction import Follower, Reduction


def lock_joints(
    robot: Robot, names: Sequence[str], q: np.ndarray, contacts: Collection[str] | None = None
) -> Reduction:
    """Return the reduction to ``robot`` with joints ``names`` welded at q (nq,), on these or all contacts.

    The small robot keeps the reference posture and the length of the whole robot, to which units and costs
    refer.
    """
    kept = tuple(c for c in robot.contacts if contacts is None or c.name in contacts)
    fewer = replace(robot, contacts=kept)
    made = Reduction(
        whole=robot,
        small=fewer.with_locked(names, reference=q) if names else fewer,
        start=q,
        joints={name: Follower(name) for name in behind_base(robot) if name not in names},
        contacts={contact.name: Follower(contact.name) for contact in kept},
    )
    small = replace(made.small, reference=made.drop_q(robot.reference), given_length=robot.length)
    return replace(made, small=small)


def behind_base(robot: Robot) -> tuple[str, ...]:
    """Names of all joints that are not part of the base."""
    first = BASE_COORDINATES[robot.base]
    return tuple(robot.model.names[j.id] for j in list(robot.model.joints)[1:] if j.idx_q >= first)
