"""The motion of an iterate between its nodes: placements of joints, paths of points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.view.replay.motion import placements

# Frame rate of the animation: its frames are closer than the nodes.
FRAME_RATE = 30.0
# Poses of the robot along the motion.
LEAST_POSES, MOST_POSES = 4, 6


@dataclass(kw_only=True, eq=False)
class IterateMotion:
    """Configurations at times: nodes t (n,) s, q (n, nq), phase (n,); placements at even frames."""

    model: pin.Model
    t: np.ndarray
    q: np.ndarray
    phase: np.ndarray
    frames: list[int]
    joints: np.ndarray = field(init=False)
    points: np.ndarray = field(init=False)
    mass: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        count = max(2, round(self.duration * FRAME_RATE) + 1)
        self.joints, self.points, self.mass = self.placed(np.linspace(self.t[0], self.t[-1], count))

    @property
    def duration(self) -> float:
        """Seconds from the first node to the last; at least one picture."""
        return max(float(self.t[-1] - self.t[0]), 1 / FRAME_RATE)

    def placed(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place the robot at times (k,).

        Returns:
            Placements of joints (k, njoints, 4, 4); positions of ``frames`` (k, f, 3) and of the centre of
            mass (k, 3), m, world.
        """
        q, data = np.array([self._at(float(t)) for t in times]), self.model.createData()
        joints, frames = placements(self.model, self.frames, q)
        mass = np.array([pin.centerOfMass(self.model, data, row) for row in q])
        return joints, frames[:, :, :3, 3], mass

    def _at(self, t: float) -> np.ndarray:
        """Configuration on the geodesic between the nodes around ``t``."""
        last = int(np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, max(len(self.t) - 2, 0)))
        if last + 1 >= len(self.t) or not self.t[last + 1] > self.t[last]:
            return np.asarray(self.q[last])
        part = float(np.clip((t - self.t[last]) / (self.t[last + 1] - self.t[last]), 0.0, 1.0))
        return np.asarray(pin.interpolate(self.model, self.q[last], self.q[last + 1], part))

    def poses(self) -> np.ndarray:
        """Times (k,) of drawn poses: starts of phases and the end; evenly spaced if those are few."""
        starts = np.flatnonzero(np.diff(self.phase)) + 1
        changes = np.unique(np.concatenate([self.t[:1], self.t[starts], self.t[-1:]]))
        if LEAST_POSES <= len(changes) <= MOST_POSES:
            return changes
        if len(changes) > MOST_POSES:
            return np.asarray(changes[np.linspace(0, len(changes) - 1, MOST_POSES).round().astype(int)])
        return np.linspace(self.t[0], self.t[-1], LEAST_POSES)
