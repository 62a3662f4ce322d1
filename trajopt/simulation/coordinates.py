"""Maps between the coordinates of Pinocchio and MuJoCo for the same joints.

Both have one velocity per degree of freedom, in the same order within a joint. They differ in

    free-flyer, planar   linear velocity in the body's axes (Pinocchio), in the parent's (MuJoCo): v' = R v
    quaternions          (x, y, z, w) and (w, x, y, z)
    continuous, planar   (cos, sin) and the angle itself, which counts whole turns

so that with the orthogonal map T of velocities, v' = T v, forces become f' = T f, and in the linear rows
accelerations become a' = T (a + w x v). Arrays have one row per sample; angles are continuous along them.
"""

from dataclasses import dataclass

import numpy as np

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.motion.local_states import rotation_matrices


@dataclass(frozen=True, kw_only=True)
class JointAddress:
    """Where MuJoCo stores a joint's coordinates: slices of qpos and of qvel."""

    joint: Joint
    q: slice
    v: slice


@dataclass(frozen=True, kw_only=True)
class CoordinateMap:
    """Maps samples (n, ...) both ways. ``nq``: size of MuJoCo's qpos; nv is the same in both."""

    coordinates: Coordinates
    addresses: tuple[JointAddress, ...]
    nq: int

    @property
    def rows(self) -> np.ndarray:
        """Index in MuJoCo's velocity of each entry of Pinocchio's (nv,)."""
        rows = np.zeros(self.coordinates.nv, dtype=int)
        for address in self.addresses:
            rows[address.joint.v] = np.arange(address.v.start, address.v.stop)
        return rows

    def to_mujoco(self, q: np.ndarray) -> np.ndarray:
        """Convert Pinocchio's configurations (n, nq) to MuJoCo's positions (n, nq')."""
        qpos = np.zeros((len(q), self.nq))
        for address in self.addresses:
            kind, part = address.joint.kind, q[:, address.joint.q]
            if kind == "continuous":
                qpos[:, address.q] = np.unwrap(np.arctan2(part[:, 1], part[:, 0]))[:, None]
            elif kind == "planar":
                angle = np.unwrap(np.arctan2(part[:, 3], part[:, 2]))
                qpos[:, address.q] = np.column_stack([part[:, :2], angle])
            elif kind in ("freeflyer", "spherical"):
                qpos[:, address.q] = np.column_stack([part[:, :-4], part[:, -1], part[:, -4:-1]])
            else:
                qpos[:, address.q] = part
        return qpos

    def from_mujoco(self, qpos: np.ndarray) -> np.ndarray:
        """Convert MuJoCo's positions (n, nq') to Pinocchio's configurations (n, nq)."""
        q = np.zeros((len(qpos), self.coordinates.nq))
        for address in self.addresses:
            kind, part = address.joint.kind, qpos[:, address.q]
            if kind == "continuous":
                q[:, address.joint.q] = np.column_stack([np.cos(part), np.sin(part)])
            elif kind == "planar":
                angle = part[:, 2]
                q[:, address.joint.q] = np.column_stack([part[:, :2], np.cos(angle), np.sin(angle)])
            elif kind in ("freeflyer", "spherical"):
                q[:, address.joint.q] = np.column_stack([part[:, :-4], part[:, -3:], part[:, -4]])
            else:
                q[:, address.joint.q] = part
        return q

    def rates_to_mujoco(self, qpos: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Convert Pinocchio's velocities or forces (n, nv) to MuJoCo's at ``qpos`` (n, nq')."""
        qvel = np.zeros_like(v, dtype=float)
        for address in self.addresses:
            qvel[:, address.v] = _turned(address, qpos, v[:, address.joint.v], back=False)
        return qvel

    def rates_from_mujoco(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Convert MuJoCo's velocities or forces (n, nv) to Pinocchio's at ``qpos`` (n, nq')."""
        v = np.zeros_like(qvel, dtype=float)
        for address in self.addresses:
            v[:, address.joint.v] = _turned(address, qpos, qvel[:, address.v], back=True)
        return v

    def accelerations_from_mujoco(self, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray) -> np.ndarray:
        """Convert MuJoCo's accelerations (n, nv): a = T' qacc - w x v in the linear rows of a moving base."""
        a, v = self.rates_from_mujoco(qpos, qacc), self.rates_from_mujoco(qpos, qvel)
        for address in self.addresses:
            rows, part = address.joint.v, v[:, address.joint.v]
            if address.joint.kind == "freeflyer":
                a[:, rows.start : rows.start + 3] -= np.cross(part[:, 3:], part[:, :3])
            elif address.joint.kind == "planar":
                turned = part[:, 2:] * np.column_stack([-part[:, 1], part[:, 0]])
                a[:, rows.start : rows.start + 2] -= turned
        return a


def _turned(address: JointAddress, qpos: np.ndarray, rows: np.ndarray, *, back: bool) -> np.ndarray:
    """Rotate a joint's linear rows (n, .) from the body's axes to the parent's, or back."""
    kind = address.joint.kind
    if kind not in ("freeflyer", "planar"):
        return rows
    part = qpos[:, address.q]
    if kind == "freeflyer":  # MuJoCo's quaternions have w first
        turn = rotation_matrices(part[:, [4, 5, 6, 3]] / np.linalg.norm(part[:, 3:], axis=1, keepdims=True))
    else:
        turn = _plane_rotations(part[:, 2])
    size = turn.shape[1]
    linear = np.einsum("nji,nj->ni" if back else "nij,nj->ni", turn, rows[:, :size])
    return np.column_stack([linear, rows[:, size:]])


def _plane_rotations(angle: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
