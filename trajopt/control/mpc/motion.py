"""The motion of a horizon: state, acceleration, torques and contact forces at any time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.control.mpc.horizon import Horizon
from trajopt.errors import InputError
from trajopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class FollowedSample:
    """Pinocchio's q (nq,), v and a (nv,); torque (nu,); contact forces (nc, 6), world axes; active (nc,)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    forces: np.ndarray
    active: np.ndarray


class HorizonMotion:
    """The motion of a horizon's scaled variables x from ``begin`` s on; it is independent of the horizon."""

    def __init__(self, horizon: Horizon, x: np.ndarray, begin: float) -> None:
        layout, unscaled = horizon.layout, x * horizon.transcription.scale
        self.begin, self.robot = begin, horizon.robot
        self.model, self.data = horizon.robot.model, horizon.robot.model.createData()
        self.times, self.steps = horizon.node_times, horizon.steps
        self.phase_of, self.coordinates = layout.phase_of, layout.coordinates
        self.nodes = np.array([unscaled[layout.node(k)] for k in range(layout.n_stages + 1)])
        schemes = [layout.scheme_of(phase) for phase in range(len(horizon.pattern.contacts))]
        self.weights = [each.polynomials for each in schemes]
        self.contacts = layout.contacts
        self.levers = horizon.transcription.problem.levers
        self.highest: list[np.ndarray] = []
        self.wrenches: list[np.ndarray] = []
        for k in range(layout.n_stages):
            window, phase = unscaled[layout.window(k)], int(self.phase_of[k])
            points = range(schemes[phase].s)
            self.highest.append(np.array([window[layout.local_derivative(phase, i)] for i in points]))
            self.wrenches.append(np.array([window[layout.local_wrench(phase, i)] for i in points]))

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.times[-1])

    def _state(self, time: float) -> tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Phase, Pinocchio's q, v, a and the wrenches at ``time`` s."""
        t = min(max(time - self.begin, 0.0), self.duration)
        k = min(int(np.searchsorted(self.times, t, side="right")) - 1, len(self.steps) - 1)
        phase, h, node = int(self.phase_of[k]), float(self.steps[k]), self.nodes[k]
        c, polynomials = (t - float(self.times[k])) / h, self.weights[phase]
        n_rotation, nv = 4 * self.coordinates.n_rotations, self.coordinates.nv
        weights, rate, position = c ** np.arange(polynomials.shape[1]) @ polynomials
        start = np.zeros(nv)
        start[self.coordinates.additive_index] = node[n_rotation:-nv]
        y, first = self.highest[k], node[-nv:]
        xi = start + h * c * first + h * h * (position @ y)
        dxi = first + h * (rate @ y)
        state = self.coordinates.local_to_pinocchio(node[:n_rotation], xi, dxi, weights @ y)
        q, v, a = (part[0] for part in state)
        return phase, q, v, a, weights @ self.wrenches[k]

    def configuration(self, time: float) -> np.ndarray:
        """The configuration (nq,) at ``time`` s."""
        return self._state(time)[1]

    def sample(self, time: float) -> FollowedSample:
        """The motion at ``time`` s; its first sample before its begin, and its last one after its end."""
        phase, q, v, a, wrench = self._state(time)
        nv = self.coordinates.nv
        forces, active = np.zeros((len(self.robot.contacts), 6)), np.zeros(len(self.robot.contacts), bool)
        at = 0
        load = np.zeros(nv)
        pin.computeJointJacobians(self.model, self.data, q)
        for contact in self.contacts[phase]:
            number, rows = self.robot.contacts.index(contact), list(contact.rows)
            forces[number, rows] = wrench[at : at + len(rows)]
            if contact.name in self.levers[phase]:
                forces[number, 3:] = np.cross(forces[number, :3], self.levers[phase][contact.name])
            at, active[number] = at + len(rows), True
            frame = self.model.getFrameId(contact.frame)
            jacobian = pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED)
            load += jacobian.T @ forces[number]
        needed = pin.rnea(self.model, self.data, q, v, a) - load
        torque = self.robot.actuation.inputs(needed)
        return FollowedSample(q=q, v=v, a=a, torque=torque, forces=forces, active=active)


def predicted(
    motion: HorizonMotion,
    time: float,
    delay: float,
    state: tuple[np.ndarray, np.ndarray],
    bandwidth: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """The state (nq,), (nv,) ``delay`` s after ``time``: the motion's, plus what remains of the error.

    The error of the measured ``state`` decays as dd e = -2 w de - w^2 e under feedback with the ``bandwidth``
    w, one for all rows or one for each (nv,), 1/s.
    """
    model, w = motion.model, bandwidth
    now, then = motion.sample(time), motion.sample(time + delay)
    error, rate = pin.difference(model, now.q, state[0]), state[1] - now.v
    left, kept = rate + w * error, np.exp(-w * delay)
    q = pin.integrate(model, then.q, kept * (error + delay * left))
    return q, then.v + kept * (rate - w * delay * left)


def require_state(robot: Robot, time: float, q: np.ndarray, v: np.ndarray) -> None:
    """Raise `InputError` for a time or a measured state that is not finite, or a state of the wrong shape."""
    if not math.isfinite(time):
        raise InputError(f"time of a tick is {time}", "allowed: finite, s")
    for name, given, size in (("q", q, robot.nq), ("v", v, robot.nv)):
        if np.shape(given) != (size,):
            raise InputError(f"{name} of a state has shape {np.shape(given)}", f"allowed: ({size},)")
        if not np.isfinite(given).all():
            index = int(np.flatnonzero(~np.isfinite(given))[0])
            raise InputError(f"{name}[{index}] of a state is {given[index]}", "allowed: finite numbers")
