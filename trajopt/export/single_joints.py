"""The joints of a robot other than its moving base, each with one position and one velocity."""

from dataclasses import dataclass

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.solution.solution import Solution


@dataclass(frozen=True, kw_only=True, eq=False)
class SingleJoints:
    """Joints of one degree of freedom: names (d,), rows (d,) in v, and places (d,) of their first entry in q.

    counted: (d,) whether q holds the cosine and sine of the angle.
    """

    names: tuple[str, ...]
    rows: np.ndarray
    places: np.ndarray
    counted: np.ndarray


def single_joints(plan: Solution) -> SingleJoints:
    """The joints other than the base; raises `InputError` for one with several degrees of freedom."""
    single = Coordinates(plan.model).joints[BASE_JOINT[base_of(plan.model)] :]
    for joint in single:
        if joint.v.stop - joint.v.start != 1:
            raise InputError(
                f"joint '{joint.name}' has several degrees of freedom", "allowed: one, beside a moving base"
            )
    return SingleJoints(
        names=tuple(joint.name for joint in single),
        rows=np.array([joint.v.start for joint in single], dtype=int),
        places=np.array([joint.q.start for joint in single], dtype=int),
        counted=np.array([joint.is_counted for joint in single], dtype=bool),
    )


def joint_angles(joints: SingleJoints, q: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Positions (n, d) of joints at times ``t`` (n,), rad or m; continuous where q has cosine and sine.

    The velocities tell how many whole turns a continuous joint makes from sample to sample.
    """
    angles = q[:, joints.places]
    for column in np.flatnonzero(joints.counted):
        place = joints.places[column]
        angle = np.arctan2(q[:, place + 1], q[:, place])
        rate = v[:, joints.rows[column]]
        expected = (rate[1:] + rate[:-1]) / 2 * np.diff(t)
        turns = np.round((expected - np.diff(angle)) / (2 * np.pi))
        angles[:, column] = angle + 2 * np.pi * np.append(0.0, np.cumsum(turns))
    return angles
