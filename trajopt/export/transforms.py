"""The tree of a robot's frames: each link relative to its parent, and contact frames on links."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.links import frame_motion, link_frames, without_jumps

# Parent of the frames that have no parent link.
WORLD_FRAME = "world"


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTree:
    """F frames at n times, each relative to its parent; SI units.

    names, parents: (F,); ``world`` is not a frame itself. fixed: (F,) whether it is fixed to its parent.
    position: (n, F, 3). quaternion: (n, F, 4) xyzw.
    """

    names: tuple[str, ...]
    parents: tuple[str, ...]
    fixed: tuple[bool, ...]
    position: np.ndarray
    quaternion: np.ndarray


def frame_tree(motion: ExportedMotion) -> FrameTree:
    """The tree of all links, and of the contact frames that are not links."""
    model, links = motion.model, motion.links
    contacts = {
        name: model.getFrameId(name) for name in motion.plan.contact_frames if name not in links.names
    }
    touching = frame_motion(model, contacts, motion.q, motion.v)
    position = np.concatenate([links.position, touching.position], axis=1)
    turn = np.concatenate([links.quaternion, touching.quaternion], axis=1)[..., [1, 2, 3, 0]]
    frames, names = link_frames(model) | contacts, (*links.names, *contacts)
    joints = [
        model.frames[frames[name]].parentJoint if name in frames else model.getJointId(name) for name in names
    ]
    parents = _parents(model, frames, links.names, names, joints)
    moved, turned = _seen_from_parents(parents, position, turn)
    return FrameTree(
        names=names,
        parents=tuple(WORLD_FRAME if parent is None else names[parent] for parent in parents),
        fixed=tuple(
            joint == (0 if parent is None else joints[parent])
            for joint, parent in zip(joints, parents, strict=True)
        ),
        position=moved,
        quaternion=turned,
    )


def _parents(
    model: pin.Model,
    frames: dict[str, int],
    links: tuple[str, ...],
    names: tuple[str, ...],
    joints: list[int],
) -> list[int | None]:
    """Index of the parent link of each frame; None for the world.

    It is that of the robot's description. If the model does not have it, as behind a locked joint, it is the
    first link of the same joint, or of the joint before.
    """
    first = {joint: i for i, joint in reversed(list(enumerate(joints))) if i < len(links)}
    parents: list[int | None] = []
    for frame, (name, joint) in enumerate(zip(names, joints, strict=True)):
        above = _link_above(model, frames[name], links) if name in frames else None
        before = joint if first.get(joint, frame) != frame else model.parents[joint]
        if above is None and first.get(before, frame) != frame:
            above = first[before]
        parents.append(above)
    return parents


def _link_above(model: pin.Model, frame: int, links: tuple[str, ...]) -> int | None:
    """Index of the nearest link between a frame and the world; None if there is none."""
    passed: set[int] = set()
    while frame and frame not in passed:  # a locked joint may be its own parent
        passed.add(frame)
        frame = model.frames[frame].parentFrame
        above = model.frames[frame]
        if above.type == pin.BODY and above.name in links and frame not in passed:
            return links.index(above.name)
    return None


def _seen_from_parents(
    parents: list[int | None], position: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, F, 3), and quaternions (n, F, 4) xyzw with continuous signs, relative to the parents."""
    moved, turned = position.copy(), turn.copy()
    for frame, parent in enumerate(parents):
        if parent is not None:
            back = Rotation.from_quat(turn[:, parent]).inv()
            moved[:, frame] = back.apply(position[:, frame] - position[:, parent])
            turned[:, frame] = (back * Rotation.from_quat(turn[:, frame])).as_quat()
    return moved, without_jumps(turned[..., [3, 0, 1, 2]])[..., [1, 2, 3, 0]]
