"""What a frame of a LeRobot data set holds: features by name, each with the names of its entries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.export.exported_motion import ExportedMotion

AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True, eq=False)
class Feature:
    """Values of all frames: (n, k) float32 with the names of the k entries, or (n,) without names."""

    values: np.ndarray
    names: tuple[str, ...] | None = None

    @property
    def size(self) -> int:
        """Number of entries."""
        return 1 if self.names is None else len(self.names)

    @property
    def described(self) -> dict[str, Any]:
        """Its entry in ``features`` of info.json."""
        names = None if self.names is None else list(self.names)
        return {"dtype": str(self.values.dtype), "shape": [self.size], "names": names}


def features_of(motion: ExportedMotion, *, episode: int, start: int, task: int) -> dict[str, Feature]:
    """Features of a motion by name, without those of no entries; ``start``: index of its first frame."""
    frames, count = np.arange(len(motion.t)), len(motion.t)
    features = {
        "observation.state": _vector(
            np.hstack([motion.joint_position, motion.joint_velocity]),
            [f"{name}.pos" for name in motion.joint_names] + [f"{name}.vel" for name in motion.joint_names],
        ),
        "action": _vector(motion.drive_torque, [f"{name}.torque" for name in motion.plan.torque_names]),
        **_base_features(motion),
        **_contact_features(motion),
        "timestamp": Feature(values=(frames / motion.rate).astype(np.float32)),
        "frame_index": Feature(values=frames),
        "episode_index": Feature(values=np.full(count, episode)),
        "index": Feature(values=start + frames),
        "task_index": Feature(values=np.full(count, task)),
    }
    return {key: feature for key, feature in features.items() if feature.size}


def _vector(values: np.ndarray, names: list[str]) -> Feature:
    return Feature(values=values.astype(np.float32), names=tuple(names))


def _base_features(motion: ExportedMotion) -> dict[str, Feature]:
    """Pose and velocity of the link that a moving base carries, world axes; quaternion xyzw."""
    links, base = motion.links, motion.links.base
    if base is None:
        return {}
    pose = np.hstack([links.position[:, base], links.quaternion[:, base][:, [1, 2, 3, 0]]])
    velocity = np.hstack([links.linear_velocity[:, base], links.angular_velocity[:, base]])
    twist = [f"{part}.{axis}" for part in ("linear", "angular") for axis in AXES]
    return {
        "observation.base_pose": _vector(pose, [*AXES, "qx", "qy", "qz", "qw"]),
        "observation.base_velocity": _vector(velocity, twist),
    }


def _contact_features(motion: ExportedMotion) -> dict[str, Feature]:
    """Contacts that are active, forces, and moments of soles, which points do not have; world axes."""
    frames, count = motion.plan.contact_frames, len(motion.t)
    soles = np.flatnonzero(motion.plan.description.soles).tolist()
    force = motion.f[..., :3].reshape(count, -1)
    moment = motion.f[:, soles, 3:].reshape(count, -1)
    return {
        "observation.contacts": _vector(motion.active, list(frames)),
        "observation.contact_forces": _vector(force, [f"{name}.{axis}" for name in frames for axis in AXES]),
        "observation.contact_moments": _vector(
            moment, [f"{frames[i]}.{axis}" for i in soles for axis in AXES]
        ),
    }
