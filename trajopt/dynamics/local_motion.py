"""Pinocchio's (q, v, a) as local coordinates of an interval: the inverse of `Coordinates.to_pinocchio`."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.dynamics.manifold import Coordinates, Joint
from trajopt.dynamics.rotations import body_rate_function

Local = tuple[np.ndarray, np.ndarray, np.ndarray]


def local_from_pinocchio(
    coordinates: Coordinates, rotations: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> Local:
    """Local coordinates and their first two derivatives, each (nv,), of one state near an interval's start.

    rotations: (4 n_rotations,) quaternions (x, y, z, w) of the start. q (nq,), v, a (nv,): Pinocchio's.
    Angles of continuous and planar joints are within (-pi, pi]: q does not tell whole turns.
    """
    xi, rate, second = np.zeros(coordinates.nv), np.array(v, dtype=float), np.array(a, dtype=float)
    starts = iter(np.reshape(rotations, (-1, 4)))
    for joint in coordinates.joints:
        if joint.kind == "plain":
            xi[joint.v] = q[joint.q]
        elif joint.kind == "continuous":
            xi[joint.v] = math.atan2(q[joint.q][1], q[joint.q][0])
        elif joint.kind == "planar":
            _planar(joint, q, xi, rate, second)
        else:
            _rotating(joint, next(starts), q, xi, rate, second)
    return xi, rate, second


def _planar(joint: Joint, q: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray) -> None:
    x, y, cosine, sine = q[joint.q]
    turn = np.array([[cosine, -sine], [sine, cosine]])
    two, turning = slice(joint.v.start, joint.v.start + 2), rate[joint.v][2]
    xi[joint.v] = [x, y, math.atan2(sine, cosine)]
    linear = rate[two].copy()
    rate[two] = turn @ linear
    second[two] = turn @ (second[two] + turning * np.array([-linear[1], linear[0]]))


def _rotating(
    joint: Joint, start: np.ndarray, q: np.ndarray, xi: np.ndarray, rate: np.ndarray, second: np.ndarray
) -> None:
    """A free-flyer or spherical joint: omega' = Jr theta'' + (what of it theta and theta' give alone)."""
    rows = joint.rotation
    assert rows is not None
    here = pin.Quaternion(np.array(q[joint.q][-4:])).toRotationMatrix()
    omega = rate[rows].copy()
    if joint.kind == "freeflyer":
        three = slice(joint.v.start, joint.v.start + 3)
        xi[three] = q[joint.q][:3]
        linear = rate[three].copy()
        rate[three] = here @ linear
        second[three] = here @ (second[three] + np.cross(omega, linear))
    theta = pin.log3(pin.Quaternion(np.array(start)).normalized().toRotationMatrix().T @ here)
    to_theta = np.linalg.inv(pin.Jexp3(theta))
    xi[rows], rate[rows] = theta, to_theta @ omega
    turning = body_rate_function()(theta, rate[rows], np.zeros(3))[1]
    second[rows] = to_theta @ (second[rows] - np.array(turning).ravel())
