"""Motions whose truth is known without the toolkit's solver, sampled as a solution."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from trajopt.motion.meta import description_of, jsonable, statistics_of
from trajopt.motion.solution import Solution
from trajopt.robot.robot import Robot

# Gauss-Legendre points of degree two: torques linear in an interval are met exactly.
LEGENDRE = (0.5 - np.sqrt(3) / 6, 0.5 + np.sqrt(3) / 6)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One phase: functions of time (s) of a robot with the contacts of the phase."""

    duration: float
    contacts: tuple[str, ...]
    q: Callable[[float], np.ndarray]
    v: Callable[[float], np.ndarray]
    a: Callable[[float], np.ndarray]
    tau: Callable[[float], np.ndarray]
    f: Callable[[float], np.ndarray]


def meta_of(robot: Robot, **changes: Any) -> dict[str, Any]:
    return {
        "format": "trajopt-solution",
        "version": 1,
        "problem": "synthetic",
        "parameters": {},
        "robot": robot.name,
        "contact_frames": [contact.frame for contact in robot.contacts],
        "contact_kinds": [contact.kind for contact in robot.contacts],
        "contact_radius": [contact.radius for contact in robot.contacts],
        "friction": [0.7] * len(robot.contacts),
        "effort_limit": None if robot.torque_limit is None else robot.torque_limit.tolist(),
        "velocity_limit": [None if np.isinf(limit) else limit for limit in robot.velocity_limit],
        "terrain": {"kind": "flat", "height": 0.0, "normal": [0.0, 0.0, 1.0], "friction": 0.7},
        "transcription": "legendre:2",
        "solver": "none",
        "status": "solved",
        "success": True,
        "iterations": 0,
        "objective": 0.0,
        "tolerance": 1e-6,
        "wall_time_s": 0.0,
        "gravity": robot.model.gravity.linear.tolist(),
        "versions": {},
        **changes,
    }


def with_meta(solution: Solution, drop: tuple[str, ...] = (), **changes: object) -> Solution:
    """The solution as read from a file with other entries of its ``meta``, and without those of ``drop``."""
    meta = {k: v for k, v in jsonable({**solution.meta, **changes}).items() if k not in drop}
    phases = len(solution.phases)
    return replace(solution, description=description_of(meta, phases), statistics=statistics_of(meta))


def sampled(
    robot: Robot, motions: list[Motion], intervals: int, points: tuple[float, ...] = LEGENDRE, **meta: Any
) -> Solution:
    """Sample every motion with ``intervals`` intervals of the same collocation ``points`` each."""
    names = [contact.name for contact in robot.contacts]
    columns: dict[str, list[Any]] = {name: [] for name in Solution.__dataclass_fields__}
    start, number = 0.0, 0
    for phase, motion in enumerate(motions):
        step = motion.duration / intervals
        for k in range(intervals):
            columns["interval_t"].append([start + k * step, start + (k + 1) * step])
            for order, fraction in enumerate((0.0, *points, 1.0)):
                local = (k + fraction) * step
                for name in ("q", "v", "a", "tau", "f"):
                    columns[name].append(getattr(motion, name)(local))
                columns["t"].append(start + local)
                columns["phase"].append(phase)
                columns["interval"].append(number)
                columns["collocation"].append(0 < order <= len(points))
                columns["active"].append([name in motion.contacts for name in names])
            number += 1
        start += motion.duration
    arrays = {name: np.array(rows) for name, rows in columns.items() if rows}
    arrays["f"] = arrays["f"].reshape(len(arrays["t"]), len(names), 6)
    arrays["active"] = arrays["active"].reshape(len(arrays["t"]), len(names))
    given = jsonable(meta_of(robot, **meta))
    return Solution(
        description=description_of(given, len(motions)),
        statistics=statistics_of(given),
        model=robot.limited_model(),
        **arrays,
    )


def at_rest(robot: Robot, duration: float) -> Motion:
    """The reference posture over time, without torques and without contacts."""
    still = np.zeros(robot.nv)
    return Motion(
        duration=duration,
        contacts=(),
        q=lambda t: robot.reference,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: np.zeros(robot.nu),
        f=lambda t: np.zeros((len(robot.contacts), 6)),
    )


def arm_motion(robot: Robot, duration: float = 1.0) -> Motion:
    """An arm without contacts on a sine in every joint, torques by inverse dynamics."""
    data = robot.model.createData()
    swing, rate = np.linspace(0.3, -0.4, robot.nv), np.linspace(1.0, 2.0, robot.nv)

    def q(t: float) -> np.ndarray:
        return robot.reference + swing * np.sin(rate * t)

    def v(t: float) -> np.ndarray:
        return swing * rate * np.cos(rate * t)

    def a(t: float) -> np.ndarray:
        return -swing * rate**2 * np.sin(rate * t)

    def tau(t: float) -> np.ndarray:
        return pin.rnea(robot.model, data, q(t), v(t), a(t)).copy()

    return Motion(duration=duration, contacts=(), q=q, v=v, a=a, tau=tau, f=lambda t: np.zeros((0, 6)))


def tumbling_flight(robot: Robot, duration: float = 0.3) -> Motion:
    """A floating robot thrown up and spinning; joint torques linear in time, integrated to 1e-12."""
    model, data = robot.model, robot.model.createData()
    first, slope = np.linspace(-0.02, 0.02, robot.nu), np.linspace(0.05, -0.1, robot.nu)
    q0, v0 = robot.reference.copy(), np.zeros(robot.nv)
    q0[2] += 1.0
    v0[:6] = [0.4, 0.1, 1.0, 2.0, -3.0, 1.5]

    def tau(t: float) -> np.ndarray:
        return first + slope * t

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = pin.normalize(model, state[: robot.nq]), state[robot.nq :]
        acceleration = pin.aba(model, data, q, v, np.concatenate([np.zeros(6), tau(t)]))
        return np.concatenate([freeflyer_rate(state[: robot.nq], v), v[6:], acceleration])

    return _from_path(robot, np.concatenate([q0, v0]), rate, duration, (), tau, None)


def standing(robot: Robot, duration: float = 0.4) -> Motion:
    """A legged robot at rest in its reference posture, its weight shared by least squares."""
    model, data = robot.model, robot.model.createData()
    q0, still = robot.reference.copy(), np.zeros(robot.nv)
    gravity = pin.rnea(model, data, q0, still, still).copy()
    pin.computeJointJacobians(model, data, q0)
    pin.updateFramePlacements(model, data)
    jacobian = np.vstack(
        [
            pin.getFrameJacobian(model, data, model.getFrameId(contact.frame), pin.LOCAL_WORLD_ALIGNED)[
                : contact.dimension
            ]
            for contact in robot.contacts
        ]
    )
    stacked = np.linalg.lstsq(jacobian[:, :6].T, gravity[:6], rcond=None)[0]
    forces, row = np.zeros((len(robot.contacts), 6)), 0
    for index, contact in enumerate(robot.contacts):
        forces[index, : contact.dimension] = stacked[row : row + contact.dimension]
        row += contact.dimension
    torque = (gravity - jacobian.T @ stacked)[6:]
    return Motion(
        duration=duration,
        contacts=tuple(contact.name for contact in robot.contacts),
        q=lambda t: q0,
        v=lambda t: still,
        a=lambda t: still,
        tau=lambda t: torque,
        f=lambda t: forces,
    )


def planar_flight(robot: Robot, duration: float = 0.3) -> Motion:
    """A planar robot thrown up and spinning without torques, integrated to 1e-12."""
    model, data, nq = robot.model, robot.model.createData(), robot.nq
    v0 = np.concatenate([[0.5, 1.0, 3.0], np.linspace(-0.5, 0.5, robot.nu)])

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = pin.normalize(model, state[:nq]), state[nq:]
        cosine, sine = q[2:4]
        base = [cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], -sine * v[2], cosine * v[2]]
        return np.concatenate([base, v[3:], pin.aba(model, data, q, v, np.zeros(robot.nv))])

    start = np.concatenate([robot.reference + np.eye(nq)[1], v0])
    return _from_path(robot, start, rate, duration, (), lambda t: np.zeros(robot.nu), None)


def pushing_off(robot: Robot, duration: float = 0.15) -> Motion:
    """A legged robot that rises on its four feet: holding torques and a linear ramp, integrated to 1e-12.

    Accelerations and contact forces come from a least-squares solution of the whole KKT system.
    """
    model, data = robot.model, robot.model.createData()
    stance = standing(robot)
    frames = [model.getFrameId(contact.frame) for contact in robot.contacts]
    ramp = np.array([0.0, 0.0, 2.0] * 2 + [0.0, 0.0, -2.0] * 2)  # knees stretch: front forward, hind back

    def tau(t: float) -> np.ndarray:
        return stance.tau(0.0) + ramp * t

    def kkt(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inertia = np.triu(pin.crba(model, data, q))
        inertia = inertia + np.triu(inertia, 1).T
        bias = pin.nle(model, data, q, v).copy()
        pin.forwardKinematics(model, data, q, v, np.zeros(robot.nv))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        axes = pin.LOCAL_WORLD_ALIGNED
        jacobian = np.vstack([pin.getFrameJacobian(model, data, frame, axes)[:3] for frame in frames])
        drift = [pin.getFrameClassicalAcceleration(model, data, frame, axes).linear for frame in frames]
        matrix = np.block([[inertia, -jacobian.T], [jacobian, np.zeros((12, 12))]])
        right = np.concatenate([np.concatenate([np.zeros(6), tau(t)]) - bias, -np.concatenate(drift)])
        both = np.linalg.lstsq(matrix, right, rcond=None)[0]
        return both[: robot.nv], both[robot.nv :]

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = pin.normalize(model, state[: robot.nq]), state[robot.nq :]
        return np.concatenate([freeflyer_rate(state[: robot.nq], v), v[6:], kkt(t, q, v)[0]])

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.hstack([kkt(t, q, v)[1].reshape(4, 3), np.zeros((4, 3))])

    start = np.concatenate([robot.reference, np.zeros(robot.nv)])
    return _from_path(robot, start, rate, duration, stance.contacts, tau, force)


def freeflyer_rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Time derivative (7,) of the position and quaternion of a floating base."""
    quaternion = pin.Quaternion(q[3:7])
    turning = 0.5 * (quaternion * pin.Quaternion(np.append(v[3:6], 0.0))).coeffs()
    return np.concatenate([quaternion.toRotationMatrix() @ v[:3], turning])


def _from_path(robot, start, rate, duration, contacts, tau, force):  # type: ignore[no-untyped-def]
    path = solve_ivp(
        rate,
        (0, duration),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
        dense_output=True,
        max_step=duration / 40,
    ).sol

    def q(t: float) -> np.ndarray:
        return pin.normalize(robot.model, path(t)[: robot.nq])

    def v(t: float) -> np.ndarray:
        return path(t)[robot.nq :]

    def f(t: float) -> np.ndarray:
        return np.zeros((len(robot.contacts), 6)) if force is None else force(t, q(t), v(t))

    return Motion(
        duration=duration,
        contacts=contacts,
        q=q,
        v=v,
        a=lambda t: rate(t, path(t))[-robot.nv :],
        tau=tau,
        f=f,
    )
