"""Node and interval-local coordinates of every joint: the one place where rotations are handled.

An interval starts at a node whose state is ``(rotations, positions, rates)``:

- ``rotations``: one unit quaternion (x, y, z, w) for each free-flyer or spherical joint;
- ``positions``: everything else, additive: world position of a free-flyer (m), angle of a
  continuous joint (rad, not wrapped), x, y, angle of a planar joint, q of any other joint;
- ``rates``: time derivatives (nv) of the local coordinates below; for a free-flyer the linear
  velocity in the world frame (m/s) and the angular velocity in the body frame (rad/s).

Within the interval the configuration is described by local coordinates ``xi`` (nv): equal to
``positions`` where those are additive, and exponential coordinates ``theta`` relative to the start,
``R = R_k exp(theta)``, for rotations. With ``Jr`` the right Jacobian of SO(3) the body rates are

    omega = Jr(theta) theta',     omega' = Jr(theta) theta'' + (d/dt Jr(theta)) theta'

(Sola, Deray, Atchuthan, "A micro Lie theory", 2018, eqs. 143-147), and with the base position p in
the world frame Pinocchio's body-frame twist and its rate are

    v = (R^T p', omega),          a = (R^T p'' - omega x R^T p', omega').
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics.rotations import (
    body_rates,
    exp_quaternion,
    quaternion_product,
    right_jacobian,
    rotation_matrix,
)
from trajopt.errors import UnsupportedJointError

_PLAIN = (
    "RX", "RY", "RZ", "RevoluteUnaligned", "PX", "PY", "PZ", "PrismaticUnaligned", "Translation",
    "SphericalZYX",
)  # fmt: skip
CONTINUOUS_JOINTS = ("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnalignedTpl", "RevoluteUnboundedUnaligned")
SUPPORTED_JOINTS = (
    "free-flyer, planar, spherical, revolute, continuous, prismatic, translation, spherical ZYX"
)


@dataclass(frozen=True)
class Joint:
    """Position of one joint in q and v, and the kind of its coordinates."""

    name: str
    kind: str  # "plain" | "continuous" | "planar" | "spherical" | "freeflyer"
    q: slice
    v: slice

    @property
    def is_counted(self) -> bool:
        """Whether the coordinate counts whole turns, which q does not contain."""
        return self.kind == "continuous"

    @property
    def rotation(self) -> slice | None:
        """Entries of v that belong to a rotation in exponential coordinates, or None."""
        if self.kind == "freeflyer":
            return slice(self.v.start + 3, self.v.stop)
        return self.v if self.kind == "spherical" else None


def _joint_kind(name: str, shortname: str) -> str:
    kind = shortname.removeprefix("JointModel")
    for label, kinds in (("plain", _PLAIN), ("continuous", CONTINUOUS_JOINTS)):
        if kind in kinds:
            return label
    table = {"FreeFlyer": "freeflyer", "Planar": "planar", "Spherical": "spherical"}
    if kind not in table:
        raise UnsupportedJointError(name, shortname, SUPPORTED_JOINTS)
    return table[kind]


class Coordinates:
    """Coordinates of all joints of a model: sizes, and the maps to Pinocchio's (q, v, a).

    Raises UnsupportedJointError for a joint that is not in ``SUPPORTED_JOINTS``.
    """

    def __init__(self, model: pin.Model) -> None:
        self.nq, self.nv = model.nq, model.nv
        self.joints = tuple(
            Joint(
                name,
                _joint_kind(name, joint.shortname()),
                slice(joint.idx_q, joint.idx_q + joint.nq),
                slice(joint.idx_v, joint.idx_v + joint.nv),
            )
            for name, joint in list(zip(model.names, model.joints, strict=True))[1:]
        )
        in_rotation = np.zeros(self.nv, dtype=bool)
        for joint in self.joints:
            if joint.rotation is not None:
                in_rotation[joint.rotation] = True
        self.rotation_index = np.flatnonzero(in_rotation)
        self.additive_index = np.flatnonzero(~in_rotation)

    @property
    def n_rotations(self) -> int:
        """Number of rotations in exponential coordinates."""
        return len(self.rotation_index) // 3

    @property
    def n_node(self) -> int:
        """Size of a node's state: 4 per rotation, the additive positions, and nv rates."""
        return 4 * self.n_rotations + len(self.additive_index) + self.nv

    def split_node(self, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Node state as ``(rotations, xi, rates)``, with theta = 0 in the local coordinates xi (nv)."""
        n4 = 4 * self.n_rotations
        xi = ca.SX.zeros(self.nv)
        for row, index in enumerate(self.additive_index):
            xi[int(index)] = x[n4 + row]
        return x[:n4], xi, x[n4 + len(self.additive_index) :]

    def to_pinocchio(
        self, rotations: ca.SX, xi: ca.SX, dxi: ca.SX, ddxi: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Pinocchio's (q, v, a) from the start rotations and the local coordinates and their derivatives."""
        quaternions = iter(ca.vertsplit(rotations, 4)) if self.n_rotations else iter(())
        parts = [
            self._joint_to_pinocchio(joint, quaternions, xi[joint.v], dxi[joint.v], ddxi[joint.v])
            for joint in self.joints
        ]
        q, v, a = (ca.vertcat(*[part[i] for part in parts]) for i in range(3))
        return q, v, a

    @staticmethod
    def _joint_to_pinocchio(
        joint: Joint, quaternions: Iterator[ca.SX], x: ca.SX, dx: ca.SX, ddx: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        if joint.kind == "plain":
            return x, dx, ddx
        if joint.kind == "continuous":
            return ca.vertcat(ca.cos(x), ca.sin(x)), dx, ddx
        if joint.kind == "planar":
            rate = ca.vertcat(0, 0, dx[2])
            to_body = ca.vertcat(
                ca.horzcat(ca.cos(x[2]), ca.sin(x[2])), ca.horzcat(-ca.sin(x[2]), ca.cos(x[2]))
            )
            linear = ca.mtimes(to_body, dx[:2])
            transport = ca.cross(rate, ca.vertcat(linear, 0))[:2]
            acceleration = ca.mtimes(to_body, ddx[:2]) - transport
            return (
                ca.vertcat(x[:2], ca.cos(x[2]), ca.sin(x[2])),
                ca.vertcat(linear, dx[2]),
                ca.vertcat(acceleration, ddx[2]),
            )
        start = next(quaternions)
        quaternion = quaternion_product(start, exp_quaternion(x[-3:]))
        omega, domega = body_rates(x[-3:], dx[-3:], ddx[-3:])
        if joint.kind == "spherical":
            return quaternion, omega, domega
        to_body = rotation_matrix(quaternion).T
        linear = ca.mtimes(to_body, dx[:3])
        acceleration = ca.mtimes(to_body, ddx[:3]) - ca.cross(omega, linear)
        return ca.vertcat(x[:3], quaternion), ca.vertcat(linear, omega), ca.vertcat(acceleration, domega)

    def next_rotations(self, rotations: ca.SX, theta: ca.SX, dtheta: ca.SX, ddtheta: ca.SX) -> list[ca.SX]:
        """Rotations (4 each), body rates and their rates (3 each) of the next node from an interval's end."""
        quaternions, rates, second = [], [], []
        for i in range(self.n_rotations):
            three = slice(3 * i, 3 * i + 3)
            quaternions.append(quaternion_product(rotations[4 * i : 4 * i + 4], exp_quaternion(theta[three])))
            rates.append(ca.mtimes(right_jacobian(theta[three]), dtheta[three]))
            second.append(body_rates(theta[three], dtheta[three], ddtheta[three])[1])
        return [ca.vertcat(*quaternions), ca.vertcat(*rates), ca.vertcat(*second)]

    @cached_property
    def _node_to_pinocchio(self) -> ca.Function:
        x = ca.SX.sym("x", self.n_node)
        rotations, xi, rates = self.split_node(x)
        q, v, _ = self.to_pinocchio(rotations, xi, rates, ca.SX.zeros(self.nv))
        return ca.Function("node_to_pinocchio", [x], [q, v])

    @cached_property
    def _local_to_pinocchio(self) -> ca.Function:
        symbols = [
            ca.SX.sym(name, size)
            for name, size in zip("rxyz", (4 * self.n_rotations, *[self.nv] * 3), strict=True)
        ]
        return ca.Function("local_to_pinocchio", symbols, list(self.to_pinocchio(*symbols)))

    def node_to_pinocchio(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numeric (q, v) of node states (n, n_node) -> (n, nq), (n, nv)."""
        q, v = self._node_to_pinocchio(np.atleast_2d(x).T)
        return np.array(q).T, np.array(v).T

    def local_to_pinocchio(
        self, rotations: np.ndarray, xi: np.ndarray, dxi: np.ndarray, ddxi: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numeric (q, v, a) of n points, from rotations (n, 4 n_rotations) and three arrays (n, nv)."""
        q, v, a = self._local_to_pinocchio(rotations.T, xi.T, dxi.T, ddxi.T)
        return np.array(q).T, np.array(v).T, np.array(a).T

    def node_from_pinocchio(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Numeric node state (n_node,) of one configuration q (nq,) and velocity v (nv,)."""
        rotations, xi, rates = [], np.zeros(self.nv), np.array(v, dtype=float)
        for joint in self.joints:
            qj = q[joint.q]
            if joint.kind in ("spherical", "freeflyer"):
                rotations.append(qj[-4:])
            if joint.kind == "freeflyer":
                xi[joint.v][:3] = qj[:3]
                rates[joint.v][:3] = pin.Quaternion(*qj[[6, 3, 4, 5]]).toRotationMatrix() @ v[joint.v][:3]
            elif joint.kind == "planar":
                xi[joint.v] = [qj[0], qj[1], math.atan2(qj[3], qj[2])]
                rates[joint.v][:2] = np.array([[qj[2], -qj[3]], [qj[3], qj[2]]]) @ v[joint.v][:2]
            elif joint.kind == "continuous":
                xi[joint.v] = math.atan2(qj[1], qj[0])
            elif joint.kind == "plain":
                xi[joint.v] = qj
        return np.concatenate([*rotations, xi[self.additive_index], rates])

    def symbolic_node(self, q: ca.SX, v: ca.SX, counted: Mapping[str, ca.SX] = MappingProxyType({})) -> ca.SX:
        """Symbolic node state (n_node,) of q (nq,) and v (nv,), as ``node_from_pinocchio``.

        ``counted`` holds angles of continuous joints by name, as q does not contain their whole turns.
        """
        rotations, xi, rates = [], ca.SX.zeros(self.nv), v + 0
        for joint in self.joints:
            qj, at = q[joint.q], joint.v
            if joint.kind in ("spherical", "freeflyer"):
                rotations.append(qj[-4:])
            if joint.kind == "freeflyer":
                three = slice(at.start, at.start + 3)
                xi[three] = qj[:3]
                rates[three] = ca.mtimes(rotation_matrix(qj[3:]), v[three])
            elif joint.kind == "planar":
                c, s, two = qj[2], qj[3], slice(at.start, at.start + 2)
                xi[at] = ca.vertcat(qj[0], qj[1], ca.atan2(s, c))
                turn = ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))
                rates[two] = ca.mtimes(turn, v[two])
            elif joint.kind == "continuous":
                xi[at] = counted.get(joint.name, ca.atan2(qj[1], qj[0]))
            elif joint.kind == "plain":
                xi[at] = qj
        return ca.vertcat(*rotations, xi[self.additive_index.tolist()], rates)

    def continued(self, node: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """The same node with the quaternion signs and whole turns that continue ``previous``."""
        node = node.copy()
        for i in range(self.n_rotations):
            four = slice(4 * i, 4 * i + 4)
            if node[four] @ previous[four] < 0:
                node[four] = -node[four]
        for joint in self.joints:
            if joint.kind in ("planar", "continuous"):
                at = 4 * self.n_rotations + int(np.searchsorted(self.additive_index, joint.v.stop - 1))
                node[at] += 2 * math.pi * round((previous[at] - node[at]) / (2 * math.pi))
        return node

    def acceleration_from_pinocchio(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Second derivative (nv,) of the local coordinates of an interval that starts at (q, v, a)."""
        ddxi = np.array(a, dtype=float)
        for joint in self.joints:
            if joint.kind == "freeflyer":
                rotation = pin.Quaternion(*q[joint.q][[6, 3, 4, 5]]).toRotationMatrix()
                linear, omega = v[joint.v][:3], v[joint.v][3:]
                ddxi[joint.v][:3] = rotation @ (a[joint.v][:3] + np.cross(omega, linear))
            elif joint.kind == "planar":
                c, s = q[joint.q][2:]
                vx, vy, rate = v[joint.v]
                ax, ay, _ = a[joint.v]
                ddxi[joint.v][:2] = np.array([[c, -s], [s, c]]) @ [ax - rate * vy, ay + rate * vx]
        return ddxi
