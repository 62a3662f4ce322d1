"""Reductions that lock joints, drop contacts, and follow one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trajopt.dynamics.base_joint import BASE_COORDINATES
from trajopt.reduced.scenes.reduction import Follower, Reduction
from trajopt.robot.building import leaving_plane
from trajopt.robot.robot import Robot


def locked(robot: Robot, names: Sequence[str], contacts: Sequence[str], q: np.ndarray) -> Reduction:
    """Return the reduction to ``robot`` with joints ``names`` welded at q (nq,), on these ``contacts`` alone.

    The small robot keeps the reference posture and the length of the whole: what units and costs refer to.
    """
    fewer = replace(robot, contacts=tuple(c for c in robot.contacts if c.name in contacts))
    made = Reduction(
        whole=robot,
        small=fewer.with_locked(names, reference=q) if names else fewer,
        start=q,
        joints={name: Follower(name) for name in behind_base(robot) if name not in names},
        contacts={name: Follower(name) for name in contacts},
    )
    small = replace(made.small, reference=made.drop_q(robot.reference), given_length=robot.length)
    return replace(made, small=small)


def behind_base(robot: Robot) -> tuple[str, ...]:
    """Names of all joints that are no part of the base."""
    first = BASE_COORDINATES[robot.base]
    return tuple(robot.model.names[j.id] for j in list(robot.model.joints)[1:] if j.idx_q >= first)


def chained(first: Reduction, second: Reduction) -> Reduction:
    """Return the reduction from the whole robot of the first to the small one of the second."""
    joints = {name: _behind(f, second.joints) for name, f in first.joints.items() if f.name in second.joints}
    contacts = {
        name: _behind(f, second.contacts) for name, f in first.contacts.items() if f.name in second.contacts
    }
    return Reduction(
        whole=first.whole,
        small=second.small,
        start=first.start,
        joints=joints,
        contacts=contacts,
        mirrored_frames=first.mirrored_frames | second.mirrored_frames,
    )


def _behind(follower: Follower, others: object) -> Follower:
    other = others[follower.name]  # type: ignore[index]
    return Follower(other.name, follower.sign * other.sign, follower.mirrored != other.mirrored)


def out_of_plane(robot: Robot, q: np.ndarray, keep: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joints of a planar robot that leave the plane at q (nq,): those to lock, and those that cannot be.

    Locked where they are, they must leave their limb joints that move in the plane, and these only: an
    abducted leg moves in a plane of its own. Limbs with a joint that is kept stay as they are.
    """
    model, leaving = robot.model, leaving_plane(robot.model, 1, q)
    to_lock: list[str] = []
    stay: list[str] = []
    for root in (j for j in range(2, model.njoints) if model.parents[j] == 1):
        limb = [j for j in range(2, model.njoints) if root in model.supports[j]]
        leaves = [model.names[j] for j in limb if j in leaving]
        movable = len(leaves) < len(limb) and not any(name in keep for name in leaves)
        (to_lock if movable else stay).extend(leaves)
    return tuple(to_lock), tuple(stay)
