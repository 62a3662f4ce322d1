"""Poses and velocities of a robot's links along a motion, by numeric Pinocchio."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.pickling import picklable

# Names of the world in robot descriptions.
WORLD = ("universe", "world")


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class LinkMotion:
    """B links at n times, world axes; SI units, arrays are read-only.

    names: (B,) parents before children. position: (n, B, 3) of the link frames. quaternion: (n, B, 4) wxyz,
    with continuous signs along time. linear_velocity: (n, B, 3) of the frames' origins. angular_velocity: (n,
    B, 3). base: index of the link that a moving base carries; None for a fixed base.
    """

    names: tuple[str, ...]
    position: np.ndarray
    quaternion: np.ndarray
    linear_velocity: np.ndarray
    angular_velocity: np.ndarray
    base: int | None = None

    def __post_init__(self) -> None:
        for array in (self.position, self.quaternion, self.linear_velocity, self.angular_velocity):
            array.setflags(write=False)


def link_frames(model: pin.Model) -> dict[str, int]:
    """Frame index of each link by name, parents before children; a link fixed to another is one of its own.

    A joint that carries no link has none, and the world itself is not a link.
    """
    return {
        frame.name: index
        for joint in range(model.njoints)
        for index, frame in enumerate(model.frames)
        if frame.parentJoint == joint and frame.type == pin.BODY and frame.name not in WORLD
    }


def link_motion(model: pin.Model, q: np.ndarray, v: np.ndarray) -> LinkMotion:
    """Poses and velocities of all links at states (n, nq), (n, nv); a joint without links counts as one."""
    bare = set(range(1, model.njoints)) - {
        model.frames[frame].parentJoint for frame in link_frames(model).values()
    }
    if bare:
        model = pin.Model(model)
        for joint in sorted(bare):
            model.addFrame(pin.Frame(model.names[joint], joint, pin.SE3.Identity(), pin.BODY))
    frames, carrying = link_frames(model), BASE_JOINT[base_of(model)]
    links = [model.frames[index] for index in frames.values()]
    carried = [i for i, frame in enumerate(links) if carrying and frame.parentJoint == carrying]
    central = [i for i in carried if links[i].placement.isIdentity()]
    return replace(frame_motion(model, frames, q, v), base=next(iter(central + carried), None))


def frame_motion(model: pin.Model, frames: dict[str, int], q: np.ndarray, v: np.ndarray) -> LinkMotion:
    """Poses and velocities of frames by name, at states (n, nq), (n, nv)."""
    data, size = model.createData(), (len(q), len(frames))
    position, linear, angular = (np.empty((*size, 3)) for _ in range(3))
    quaternion = np.empty((*size, 4))
    for row, (own_q, own_v) in enumerate(zip(q, v, strict=True)):
        pin.forwardKinematics(model, data, own_q, own_v)
        pin.updateFramePlacements(model, data)
        for column, frame in enumerate(frames.values()):
            place = data.oMf[frame]
            twist = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            position[row, column] = place.translation
            quaternion[row, column] = pin.Quaternion(place.rotation).coeffs()[[3, 0, 1, 2]]
            linear[row, column], angular[row, column] = twist.linear, twist.angular
    return LinkMotion(
        names=tuple(frames),
        position=position,
        quaternion=without_jumps(quaternion),
        linear_velocity=linear,
        angular_velocity=angular,
    )


def without_jumps(quaternion: np.ndarray) -> np.ndarray:
    """The same rotations (n, ..., 4), wxyz, with continuous signs along time; the first scalar is >= 0."""
    if not len(quaternion):
        return quaternion
    start = np.where(quaternion[:1, ..., :1] < 0, -1.0, 1.0)
    opposed = np.where((quaternion[1:] * quaternion[:-1]).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return quaternion * np.cumprod(np.concatenate([start, opposed]), axis=0)
