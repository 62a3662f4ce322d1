"""The check of motions of `object_motions`, by numeric Pinocchio alone."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin

from scripts.measure.object_motions import CORNERS, FINGER_FRICTION, MASS, SIZE, TABLE_FRICTION, WEIGHT, Plan

STIFFNESS = 900.0  # of the feedback in the check, 1/s^2
DIVERGED = 100.0  # m/s or rad/s, at which a simulation ends
FINE = 8  # places in an interval where the check looks


class Judge:
    """Numeric Pinocchio on a plan; accelerations and forces are constant in an interval."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.scene, self.model = plan, plan.scene, plan.scene.model
        self.data = self.model.createData()
        self.ids = [self.model.getFrameId(name) for name in self.scene.frames]

    def at(self, k: int, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration at a part of an interval."""
        m, h = self.model, self.plan.step
        q, v = np.split(self.plan.states[k, : m.nq + m.nv], [m.nq])
        a = (self.plan.states[k + 1, m.nq : m.nq + m.nv] - v) / h
        return pin.integrate(m, q, part * h * v + (part * h) ** 2 / 2 * a), v + part * h * a, a

    def middle(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The collocation point, on the straight way of the mean velocity."""
        _, v, a = self.at(k, 0.5)
        q = self.plan.states[k, : self.model.nq]
        return pin.integrate(self.model, q, self.plan.step / 2 * v), v, a

    def forces(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """On fingers (n, 3) and corners (4, 3), world axes, N."""
        f = WEIGHT * self.plan.states[k, self.model.nq + self.model.nv :]
        drag = -TABLE_FRICTION if k >= self.plan.touched and not self.scene.lifted else 0.0
        return f[:-4].reshape(-1, 3), np.outer(f[-4:], [drag, 0, 1])

    def wrench(self, k: int, q: np.ndarray, fingers: bool = True) -> np.ndarray:
        """On the block at its centre (6,), world axes; forces act at fingers and corners at q."""
        touching, table = self.forces(k)
        pin.framesForwardKinematics(self.model, self.data, q)
        *ends, block = (self.data.oMf[i] for i in self.ids)
        arms = [
            (end.translation - block.translation, -f)
            for end, f in zip(ends, touching, strict=True)
            if fingers
        ]
        arms += [(block.rotation @ c, f) for c, f in zip(CORNERS, table, strict=True)]
        return np.concatenate([sum(f for _, f in arms), sum(np.cross(r, f) for r, f in arms)])

    def jacobians(self, q: np.ndarray) -> list[np.ndarray]:
        """Of fingers and block (6, nv), world-aligned."""
        return [
            pin.computeFrameJacobian(self.model, self.data, q, i, pin.LOCAL_WORLD_ALIGNED) for i in self.ids
        ]

    def mass(self, q: np.ndarray) -> np.ndarray:
        """Of all joints (nv, nv)."""
        upper = np.triu(pin.crba(self.model, self.data, q))
        return upper + np.triu(upper, 1).T

    def residual(self, k: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, float]:
        """Torques over their limits, and the block's worst row over its weight (times its size)."""
        *ends, block = self.jacobians(q)
        tau = pin.rnea(self.model, self.data, q, v, a) - block.T @ self.wrench(k, q)
        tau -= sum(end[:3].T @ f for end, f in zip(ends, self.forces(k)[0], strict=True))
        return tau[:-6] / self.model.effortLimit[:-6], abs(tau[-6:] / WEIGHT / np.repeat([1, SIZE], 3)).max()

    def touching(self, q: np.ndarray) -> list[np.ndarray]:
        """Where fingers are, in the block's axes, from where they should touch."""
        pin.framesForwardKinematics(self.model, self.data, q)
        *ends, block = (self.data.oMf[i] for i in self.ids)
        return [block.actInv(e.translation) - t for e, t in zip(ends, self.scene.touches, strict=True)]

    def figures(self) -> dict[str, float]:
        """The worst of every kind over the plan."""
        count, k0 = len(self.plan.states) - 1, self.plan.touched
        worst = dict.fromkeys(("block", "between", "torque", "drift"), 0.0) | {"friction": np.inf}
        for k in range(count):
            used, block = self.residual(k, *self.middle(k))
            worst["torque"] = max(worst["torque"], abs(used).max())
            worst["block"] = max(worst["block"], block)
            for part in np.linspace(0, 1, FINE + 1):
                q, v, a = self.at(k, part)
                worst["between"] = max(worst["between"], self.residual(k, q, v, a)[1])
                if k < k0:
                    continue
                worst["drift"] = max(worst["drift"], *(float(np.linalg.norm(d)) for d in self.touching(q)))
                turn = self.data.oMf[self.ids[-1]].rotation.T
                for side, f in zip(self.scene.sides, self.forces(k)[0] / WEIGHT, strict=True):
                    push, *tangent = turn @ f * [side, 1, 1]
                    worst["friction"] = min(worst["friction"], FINGER_FRICTION * push - np.hypot(*tangent))
        return worst | {
            "alone": self.block_alone(),
            "open loop": self.simulated(0),
            "tracked": self.simulated(STIFFNESS),
        }

    def block_alone(self) -> float:
        """Distance in m from the planned end, of the block alone under the planned forces.

        Of its centre, or of the middle of a face by its turn, whichever is larger. A table lets it slide and
        turn.
        """
        m, h, count = self.model, self.plan.step / FINE, len(self.plan.states) - 1
        block = m.joints[m.njoints - 1].idx_q
        free = np.ones(6) if self.scene.lifted else np.array([1, 1, 0, 0, 0, 1])
        inertia, y = MASS * SIZE**2 / 6, np.zeros(12)  # position, velocity, turn and its rate
        y[:3] = self.plan.states[0, block : block + 3]

        def rate(k: int, y: np.ndarray, part: float) -> np.ndarray:
            q = self.at(k, part)[0]
            q[block:] = [*y[:3], *pin.Quaternion(pin.exp3(y[6:9])).coeffs()]
            wrench = self.wrench(k, q)
            turning = pin.Jlog3(pin.exp3(y[6:9])) @ pin.exp3(y[6:9]).T @ y[9:]
            moved = free * np.concatenate([wrench[:3] / MASS - [0, 0, 9.81], wrench[3:] / inertia])
            return np.concatenate([y[3:6], moved[:3], turning, moved[3:]])

        for k in range(count):
            own = partial(rate, k)
            for i in range(FINE):
                y = runge_kutta(own, y, i / FINE, h, 1 / FINE)
        end = self.plan.states[-1, block : block + 7]
        turn = pin.log3(pin.Quaternion(end[3:]).toRotationMatrix().T @ pin.exp3(y[6:9]))
        return float(max(np.linalg.norm(y[:3] - end[:3]), np.linalg.norm(turn) * SIZE / 2))

    def simulated(self, stiffness: float) -> float:
        """The same of arms and block under planned torques, where forces follow from the motion.

        With feedback of joints' errors, of a ``stiffness`` (1/s^2) times the mass matrix, damped critically.
        """
        m, d, h = self.model, self.data, self.plan.step / FINE
        q, v = np.split(self.plan.states[0, : m.nq + m.nv].copy(), [m.nq])

        def acceleration(k: int, tau: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            *ends, block = self.jacobians(q)
            bias = pin.rnea(m, d, q, v, 0 * v) - block.T @ self.wrench(k, q, fingers=False)
            mass = self.mass(q)
            if k < self.plan.touched:
                return np.linalg.solve(mass, np.pad(tau, (0, 6)) - bias)
            pin.forwardKinematics(m, d, q, v, 0 * v)
            pin.updateFramePlacements(m, d)
            base, rows, right = self.ids[-1], [], []
            speed = pin.getFrameVelocity(m, d, base, pin.LOCAL_WORLD_ALIGNED)
            drift = pin.getFrameClassicalAcceleration(m, d, base, pin.LOCAL_WORLD_ALIGNED)
            for i, end in zip(self.ids[:-1], ends, strict=True):
                r = d.oMf[i].translation - d.oMf[base].translation
                own = pin.getFrameClassicalAcceleration(m, d, i, pin.LOCAL_WORLD_ALIGNED).linear
                w = speed.angular
                rows.append(end[:3] - block[:3] + pin.skew(r) @ block[3:])
                right.append(drift.linear + np.cross(drift.angular, r) + np.cross(w, np.cross(w, r)) - own)
            if not self.scene.lifted:  # only along x: the table's forces are the planned ones
                rows.append(np.eye(m.nv)[-5:])
                right.append(np.zeros(5))
            pair = np.vstack(rows)
            zero = np.zeros((len(pair), len(pair)))
            system = np.block([[mass, -pair.T], [pair, zero]])
            return np.linalg.solve(system, np.concatenate([np.pad(tau, (0, 6)) - bias, *right]))[: m.nv]

        for k in range(len(self.plan.states) - 1):
            tau = self.residual(k, *self.middle(k))[0] * m.effortLimit[:-6]
            for i in range(FINE):

                def rate(
                    y: np.ndarray, part: float, k: int = k, tau: np.ndarray = tau, q: np.ndarray = q
                ) -> np.ndarray:
                    at, speed = pin.integrate(m, q, y[: m.nv]), y[m.nv :]
                    wanted, pace, _ = self.at(k, part)
                    error = stiffness * pin.difference(m, at, wanted) + 2 * stiffness**0.5 * (pace - speed)
                    feedback = (self.mass(at) @ error)[:-6]
                    return np.concatenate([speed, acceleration(k, tau + feedback, at, speed)])

                y = runge_kutta(rate, np.concatenate([np.zeros(m.nv), v]), i / FINE, h, 1 / FINE)
                if not abs(y).max() < DIVERGED:
                    return np.inf
                q, v = pin.integrate(m, q, y[: m.nv]), y[m.nv :]
        block = m.joints[m.njoints - 1].idx_q
        return float(np.linalg.norm(q[block : block + 3] - self.plan.states[-1, block : block + 3]))


def runge_kutta(
    rate: Callable[[np.ndarray, float], np.ndarray], y: np.ndarray, part: float, h: float, step: float
) -> np.ndarray:
    """A step of the classical scheme; ``part`` of the interval goes on by ``step``."""
    first = rate(y, part)
    second = rate(y + h / 2 * first, part + step / 2)
    third = rate(y + h / 2 * second, part + step / 2)
    fourth = rate(y + h * third, part + step)
    return y + h / 6 * (first + 2 * second + 2 * third + fourth)
