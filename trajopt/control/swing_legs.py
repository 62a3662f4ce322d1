"""Legs that step in turn: which feet swing together, and how far each reaches from its hip."""

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import position_limits

# Angles of each joint that are tried for the longest leg; with an odd number also the middle of its range.
ANGLES = 9
# Joints of a leg beyond its hip that are tried: the reach of longer legs is that of their last ones.
TRIED = 3


@dataclass(frozen=True)
class SwingLeg:
    """A leg: its hip, the first actuated joint on the way to its foot, and the foot's largest distance, m."""

    hip: int
    reach: float


def swing_leg(model: pin.Model, frame: int, actuated_rows: np.ndarray) -> SwingLeg:
    """The leg that moves a frame of the model, by trying angles within the ranges of its joints."""
    way = [
        joint
        for joint in list(model.supports[model.frames[frame].parentJoint])[1:]
        if model.joints[joint].idx_v in actuated_rows
    ]
    hip, turned = int(way[0]), way[1:][-TRIED:]
    lower, upper = position_limits(model)
    rows = [model.joints[joint].idx_q for joint in turned]
    ranges = [np.linspace(max(lower[row], -np.pi), min(upper[row], np.pi), ANGLES) for row in rows]
    data, q, longest = model.createData(), pin.neutral(model), 0.0
    for angles in itertools.product(*ranges):
        q[rows] = angles
        pin.framesForwardKinematics(model, data, q)
        longest = max(longest, float(np.linalg.norm(data.oMf[frame].translation - data.oMi[hip].translation)))
    return SwingLeg(hip, longest)


def diagonal_pairs(feet: np.ndarray, places: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """The two diagonals of four feet (4,), by their places (4, 2 or more)."""
    beside = places[:, :2] - places[:, :2].mean(axis=0)
    around = feet[np.argsort(np.arctan2(beside[:, 1], beside[:, 0]))].tolist()
    return (around[0], around[2]), (around[1], around[3])
