"""A quadruped that lies on its belly stands up, feet in place, by feedback of its joints along a path."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.robot.robot import Robot
from trajopt.simulation.joint_feedback import gains_at
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import TorqueController

# Time of the rise over sqrt(l / g), and its part in which the legs take the weight.
RISE_TIME, LOADING = 6.0, 0.2
# Distances by which feet are farther apart, over the length, heights of the base over its own, errors, m.
APART, HEIGHTS, REACHED = np.linspace(0.0, 0.5, 11), np.linspace(1.0, 0.0, 101), 1e-4


class Rise:
    """Torques of a robot that rises, then those of ``controller``, whose time begins when it stands.

    ``holding`` (nu,) are the torques at rest in the reference posture, ``period`` is that of the ticks, s,
    ``lying`` (nq,) the posture at the start. Raises `InputError` for a robot that cannot lie.
    """

    controller: TorqueController

    def __init__(self, robot: Robot, scene: Scene, holding: np.ndarray, period: float) -> None:
        self._robot, self._holding, self.lying = robot, holding, _lying(robot, scene)
        self._lasts = RISE_TIME * scene.units.time
        self._way = pin.difference(robot.model, self.lying, robot.reference)
        self._gains = gains_at(scene, robot.reference[None], np.ones((1, 4)) > 0, np.zeros(1), period)

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `TorqueController`."""
        if t >= self._lasts:
            return self.controller.torque(t - self._lasts, q, v, touching)
        part, model, rows = t / self._lasts, self._robot.model, self._robot.actuated_rows
        wanted = pin.integrate(model, self.lying, part**2 * (3 - 2 * part) * self._way)
        error, rate = pin.difference(model, q, wanted), 6 * part * (1 - part) / self._lasts * self._way - v
        torque = min(part / LOADING, 1.0) * self._holding
        torque[: len(rows)] += self._gains.kp[0] * error[rows] + self._gains.kd[0] * rate[rows]
        return torque


def _lying(robot: Robot, scene: Scene) -> np.ndarray:
    """The lowest posture (nq,) in which a link touches the ground between the feet. Raises `InputError`."""
    mujoco, model, lying = mujoco_package(), scene.compiled, []
    points = [contact.kind == "point" and not contact.rolling for contact in robot.contacts]
    for apart in APART * robot.length if robot.base == "freeflyer" and points == [True] * 4 else ():
        data, q, targets = mujoco.MjData(model), robot.reference, {}
        for name, place in contact_positions(robot, q).items():
            targets[robot.contact(name).frame] = place + np.copysign([0.0, apart, 0.0], place)
        for height in HEIGHTS * q[2]:
            posture = inverse_kinematics(robot, np.array([*q[:2], height, *q[3:]]), targets)
            q = posture.q
            data.qpos[:] = scene.coordinates.to_mujoco(q[None])[0]
            mujoco.mj_forward(model, data)
            if posture.error > REACHED or scene.links[data.contact.geom].any():
                lying += [q] if posture.error <= REACHED else []
                break
    if not lying:
        raise InputError(f"robot '{robot.name}' cannot lie", "allowed: a quadruped on point feet, low enough")
    return min(lying, key=lambda q: float(q[2]))
