"""Motions for "AMP for hardware" and its followers, as their ``AMPLoader`` reads them: 61 numbers a frame."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, BASE_ROWS, base_of
from trajopt.errors import InputError
from trajopt.export.exported_motion import ExportedMotion
from trajopt.export.links import frame_motion
from trajopt.motion.local_states import rotation_matrices

# Order of the legs in files: PyBullet's, which the loader converts to Isaac Gym's (FL, FR, RL, RR).
ORDER = ("FR", "FL", "RR", "RL")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Base:
    """Motion of the base: position (n, 3) m, quaternion (n, 4) wxyz; velocities (n, 3) along its own axes.

    turn: (n, 3, 3) rotation from the base's axes to the world's.
    """

    position: np.ndarray
    quaternion: np.ndarray
    turn: np.ndarray
    linear: np.ndarray
    angular: np.ndarray


def write_amp_hardware(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write the motion of a quadruped; raises `InputError` for other robots."""
    (motion,) = motions
    by_name = three_joint_legs(motion)
    legs = [by_name[name] for name in ORDER]
    columns = [column for leg in legs for column in leg.columns]
    feet = [leg.foot for leg in legs]
    contacts = [motion.contact_frames.index(foot) for foot in feet]
    base = _base(motion)
    position, velocity = _feet_on_base(motion, base, feet)
    frames = [
        base.position,
        base.quaternion[:, [1, 2, 3, 0]],
        motion.joints.position[:, columns],
        position,
        base.linear,
        base.angular,
        motion.joints.velocity[:, columns],
        velocity,
    ]
    described = {
        "LoopMode": "Wrap" if motion.description.periodicity else "Clamp",
        "FrameDuration": 1.0 / motion.rate,
        "EnableCycleOffsetPosition": True,
        "EnableCycleOffsetRotation": True,
        "MotionWeight": 1.0,
        "Frames": np.hstack(frames).tolist(),
        "JointNames": [motion.joints.names[column] for column in columns],
        "ToeNames": feet,
        "JointTorques": motion.joints.torque[:, columns].tolist(),
        "ToeContacts": motion.active[:, contacts].astype(int).tolist(),
        "ToeForces": motion.f[:, contacts, :3].reshape(len(motion.t), -1).tolist(),
    }
    path.write_text(_one_frame_a_line(described), encoding="utf-8")


def _base(motion: ExportedMotion) -> _Base:
    links, base = motion.links, motion.links.base
    quaternion = links.quaternion[:, base]
    turn = rotation_matrices(quaternion[:, [1, 2, 3, 0]])
    linear, angular = links.linear_velocity[:, base], links.angular_velocity[:, base]
    return _Base(
        position=links.position[:, base],
        quaternion=quaternion,
        turn=turn,
        linear=np.einsum("nji,nj->ni", turn, linear),
        angular=np.einsum("nji,nj->ni", turn, angular),
    )


def _feet_on_base(motion: ExportedMotion, base: _Base, feet: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (n, 12) of feet relative to the base, along its axes; m, m/s."""
    frames = {foot: motion.model.getFrameId(foot) for foot in feet}
    world = frame_motion(motion.model, frames, motion.q, motion.v)
    apart = np.einsum("nji,nkj->nki", base.turn, world.position - base.position[:, None])
    moved = np.einsum("nji,nkj->nki", base.turn, world.linear_velocity) - base.linear[:, None]
    moved -= np.cross(base.angular[:, None], apart)
    return apart.reshape(len(motion.t), -1), moved.reshape(len(motion.t), -1)


def _one_frame_a_line(described: Mapping[str, Any]) -> str:
    """JSON text with one line per frame in lists of frames."""
    lines = []
    for key, value in described.items():
        nested = isinstance(value, list) and value and isinstance(value[0], list)
        text = "[\n  " + ",\n  ".join(map(json.dumps, value)) + "\n]" if nested else json.dumps(value)
        lines.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


ALLOWED = "allowed: a quadruped with a floating base and three joints a leg"
# Joints per leg.
JOINTS = 3


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A leg: its foot's frame, and its joints from hip to foot as columns of the motion's joints."""

    foot: str
    columns: tuple[int, ...]


def three_joint_legs(motion: ExportedMotion) -> dict[str, Leg]:
    """Legs by name (FR, FL, RR, RL), told apart by the positions of their hips (x ahead, y to the left).

    Raises `InputError` for any other robot.
    """
    model, feet = motion.model, motion.contact_frames
    base = BASE_JOINT[base_of(model)]
    if BASE_ROWS[base_of(model)] != 6 or len(feet) != 4 or len(motion.joints.names) != 4 * JOINTS:
        raise InputError(
            f"{motion.robot} has {len(feet)} contacts and {len(motion.joints.names)} joints", ALLOWED
        )
    ends = [model.frames[model.getFrameId(foot)].parentJoint for foot in feet]
    chains = [list(model.supports[end])[base + 1 :] for end in ends]
    joints = sorted(joint for chain in chains for joint in chain)
    if joints != list(range(base + 1, model.njoints)) or {len(chain) for chain in chains} != {JOINTS}:
        raise InputError(f"the legs of {motion.robot} do not have three joints each", ALLOWED)
    hips = np.array([model.jointPlacements[chain[0]].translation for chain in chains])
    by_x = np.argsort(-hips[:, 0], kind="stable")
    legs = {}
    for place, pair in (("F", by_x[:2]), ("R", by_x[2:])):
        right, left = sorted(pair, key=lambda i: hips[i, 1])
        for side, i in (("R", right), ("L", left)):
            columns = tuple(motion.joints.names.index(model.names[joint]) for joint in chains[i])
            legs[place + side] = Leg(foot=feet[i], columns=columns)
    return legs
