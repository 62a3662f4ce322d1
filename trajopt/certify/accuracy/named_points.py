"""Named points of a robot: origins of joints and frames, and centres of mass of links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin


@dataclass(frozen=True, kw_only=True)
class NamedPoints:
    """Points that move with a model; ``by_joint`` has positions (n, 3) m in the frame of each joint."""

    model: pin.Model
    by_joint: dict[int, np.ndarray]

    @classmethod
    def of(cls, model: pin.Model) -> NamedPoints:
        """Return the origins of all joints and frames, and the centres of mass of their links."""
        places = {joint: [np.zeros(3), model.inertias[joint].lever] for joint in range(1, model.njoints)}
        for frame in model.frames:
            if frame.parentJoint > 0:
                places[frame.parentJoint].append(frame.placement.translation)
        return cls(
            model=model,
            by_joint={joint: np.unique(np.array(local), axis=0) for joint, local in places.items()},
        )

    def positions(self, q: np.ndarray) -> np.ndarray:
        """Return positions (n, 3) m in the world at q (nq,)."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q)
        joints = ((data.oMi[joint], places) for joint, places in self.by_joint.items())
        return np.vstack([joint.translation + places @ joint.rotation.T for joint, places in joints])

    def velocities(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return velocities (n, 3) m/s in the world at q (nq,), v (nv,)."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q, v)
        by_joint = []
        for joint, places in self.by_joint.items():
            twist = data.v[joint]
            by_joint.append((twist.linear + np.cross(twist.angular, places)) @ data.oMi[joint].rotation.T)
        return np.vstack(by_joint)

    def speeds(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return speeds (k, n) m/s at k states q (k, nq), v (k, nv)."""
        data = self.model.createData()
        twists = np.zeros((len(q), self.model.njoints, 6))
        for row, state in enumerate(zip(q, v, strict=True)):
            pin.forwardKinematics(self.model, data, *state)
            for joint in self.by_joint:
                twists[row, joint] = data.v[joint].vector
        owner = np.repeat(list(self.by_joint), [len(places) for places in self.by_joint.values()])
        places = np.vstack(list(self.by_joint.values()))
        carried = twists[:, owner]
        return np.asarray(np.linalg.norm(carried[..., :3] + np.cross(carried[..., 3:], places), axis=-1))

    def farthest(self, planned: np.ndarray, reached: np.ndarray) -> float:
        """Return the largest distance (m) of a point between two configurations (nq,)."""
        apart = self.positions(reached) - self.positions(planned)
        return float(np.linalg.norm(apart, axis=1).max())
