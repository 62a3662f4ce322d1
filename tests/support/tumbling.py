"""A tumbling robot driven by given joint torques, propagated by a scheme alone: its order at the nodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from tests.support.problems import hopper
from trajopt.dynamics import rigid_body
from trajopt.dynamics.manifold import Coordinates
from trajopt.transcription.schemes import Scheme

DURATION = 0.4  # s: the body turns by more than a radian
TORQUE = np.array([1.5, 6.0])  # N m, N
REFERENCE_TOLERANCE = 1e-13  # of DOP853, relative and absolute
NEWTON_TOLERANCE = 1e-13  # step of the unknowns relative to accelerations of order 100


def torque(t: float) -> np.ndarray:
    """Given joint torques (2,) at time t."""
    return TORQUE * np.array([np.sin(9 * t + 0.5), np.cos(7 * t)])


def start() -> tuple[np.ndarray, np.ndarray]:
    model = hopper().model
    q = pin.integrate(model, hopper().reference, np.array([0, 0, 0, 0.3, -0.5, 0.2, 0.1, 0.02]))
    return q, np.array([0.5, -0.3, 1.0, 2.5, -3.0, 2.0, 1.0, -0.3])


@lru_cache
def reference_end() -> tuple[np.ndarray, np.ndarray]:
    """(q, v) at the end by DOP853 on numeric Pinocchio's forward dynamics."""
    model, (q0, v0) = hopper().model, start()
    data = model.createData()

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[: model.nq].copy(), state[model.nq :]
        rotation = pin.Quaternion(q[3:7] / np.linalg.norm(q[3:7]))
        spin = rotation * pin.Quaternion(np.append(v[3:6], 0.0))
        q_rate = np.concatenate([rotation.toRotationMatrix() @ v[:3], spin.coeffs() / 2, v[6:]])
        q[3:7] = rotation.coeffs()
        return np.concatenate([q_rate, pin.aba(model, data, q, v, np.append(np.zeros(6), torque(t)))])

    tolerances = {"rtol": REFERENCE_TOLERANCE, "atol": REFERENCE_TOLERANCE}
    end = solve_ivp(rate, (0, DURATION), np.append(q0, v0), method="DOP853", **tolerances).y[:, -1]
    q = end[: model.nq]
    q[3:7] /= np.linalg.norm(q[3:7])
    return q, end[model.nq :]


@dataclass(frozen=True)
class Propagation:
    """Node states (N + 1, n_node) and second derivatives at the points (N, s, nv)."""

    nodes: np.ndarray
    y: np.ndarray


class Interval:
    """One interval of a scheme: Newton's method for y, then the next node."""

    def __init__(self, method: Scheme) -> None:
        model = hopper().model
        c = self.coordinates = Coordinates(model)
        self.method, nv = method, c.nv
        node, h = ca.SX.sym("node", c.n_node), ca.SX.sym("h")
        y, tau = ca.SX.sym("y", nv, method.s), ca.SX.sym("tau", nv, method.s)
        rotations, xi, dxi = c.split_node(node)
        rnea, rows = rigid_body.rnea(model), []
        for i in range(method.s):
            point_xi = xi + h * method.c[i] * dxi + h**2 * ca.mtimes(y, ca.DM(method.A2[i]))
            point_dxi = dxi + h * ca.mtimes(y, ca.DM(method.A1[i]))
            rows.append(rnea(*c.to_pinocchio(rotations, point_xi, point_dxi, y[:, i])) - tau[:, i])
        residual = ca.vertcat(*rows)
        inputs = [node, h, y, tau]
        self.residual = ca.Function("residual", inputs, [residual, ca.jacobian(residual, ca.vec(y))])
        end_xi = xi + h * dxi + h**2 * ca.mtimes(y, ca.DM(method.b2))
        end_dxi = dxi + h * ca.mtimes(y, ca.DM(method.b1))
        turning = c.rotation_index.tolist()
        still = 0 * end_dxi[turning]
        turned, omega, _ = c.next_rotations(rotations, end_xi[turning], end_dxi[turning], still)
        end_dxi[turning] = omega
        additive = end_xi[c.additive_index.tolist()]
        self.end = ca.Function("end", [node, h, y], [ca.vertcat(turned, additive, end_dxi)])

    def points(self, node: np.ndarray, t: float, h: float, y: np.ndarray) -> np.ndarray:
        """y (s, nv) that solves the dynamics at the points, from a guess."""
        tau = np.array([np.append(np.zeros(6), torque(t + fraction * h)) for fraction in self.method.c])
        for _ in range(20):
            residual, jacobian = self.residual(node, h, y.T, tau.T)
            step = np.linalg.solve(np.array(jacobian), np.array(residual).ravel()).reshape(y.shape)
            y = y - step
            if np.max(np.abs(step)) <= NEWTON_TOLERANCE * max(1.0, np.max(np.abs(y))) * 10:
                return y
        raise AssertionError("Newton's method did not converge")

    def propagate(self, count: int) -> Propagation:
        """The whole duration in ``count`` intervals."""
        h = DURATION / count
        nodes, ys = [self.coordinates.node_from_pinocchio(*start())], []
        y = np.zeros((self.method.s, self.coordinates.nv))
        for k in range(count):
            y = self.points(nodes[-1], k * h, h, y)
            ys.append(y)
            nodes.append(np.array(self.end(nodes[-1], h, y.T)).ravel())
        return Propagation(np.array(nodes), np.array(ys))


def end_error(propagation: Propagation, coordinates: Coordinates) -> float:
    """Distance of the last node from the reference in configuration (m, rad) and velocity."""
    q, v = (part[0] for part in coordinates.node_to_pinocchio(propagation.nodes[-1]))
    reference_q, reference_v = reference_end()
    apart = pin.difference(hopper().model, reference_q, q)
    return float(np.linalg.norm(np.concatenate([apart, v - reference_v])))


def errors_at_the_end(method: Scheme, counts: Sequence[int]) -> list[float]:
    """Errors of the last node with these numbers of intervals."""
    interval = Interval(method)
    return [end_error(interval.propagate(count), interval.coordinates) for count in counts]


def slope(counts: Sequence[int], errors: Sequence[float]) -> float:
    """The order that the errors show: the slope of their logarithms over those of the step."""
    return float(np.polyfit(np.log(DURATION / np.array(counts)), np.log(errors), 1)[0])
