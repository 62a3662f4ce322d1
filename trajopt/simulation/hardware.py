"""Sensors and drives of a simulated robot: noise, delay, resolution and speed of torques."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass

import numpy as np

from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import SimulationSettings

# Seeds the sensor noise apart from the initial noise, which uses the seed alone.
SENSORS = 1


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Sensor readings at a tick: qpos (nq',), qvel (nv,) in MuJoCo's coordinates, touching (nc,)."""

    qpos: np.ndarray
    qvel: np.ndarray
    touching: np.ndarray


class Hardware:
    """Sensors and drives of one simulation, with their memory.

    Args:
        scene: the scene.
        settings: settings of the simulation.
        period: period of the controller, s.
        torque: torques (nu,) before the first tick.
    """

    def __init__(self, scene: Scene, settings: SimulationSettings, period: float, torque: np.ndarray) -> None:
        self._model, self._settings = scene.compiled, settings
        self._units, self._time = units_of(scene), scene.units.time
        self._most = settings.torque_rate * period
        self._generator = np.random.default_rng((settings.seed, SENSORS))
        self._history: deque[Measurement] = deque(maxlen=settings.delay + 1)
        self._torque = torque.copy()

    def copy(self) -> Hardware:
        """A copy that continues in the same way, with the same random numbers."""
        duplicate = copy.copy(self)
        duplicate._generator, duplicate._history = copy.deepcopy(self._generator), self._history.copy()
        return duplicate

    def measure(self, qpos: np.ndarray, qvel: np.ndarray, touching: np.ndarray) -> Measurement:
        """Measure a state; returns the reading of ``delay`` ticks ago, or the first, for the controller."""
        measurement = Measurement(qpos=qpos.copy(), qvel=qvel.copy(), touching=touching)
        if self._settings.sensor_noise:
            size = self._settings.sensor_noise * self._units
            error = size * self._generator.standard_normal(self._model.nv)
            mujoco_package().mj_integratePos(self._model, measurement.qpos, error, 1.0)
            measurement.qvel[:] += size * self._generator.standard_normal(self._model.nv) / self._time
        self._history.append(measurement)
        return self._history[0]

    def command(self, wanted: np.ndarray) -> np.ndarray:
        """Torques (nu,) for a command: rounded, and limited in their change from the last ones."""
        torque, step = wanted, self._settings.torque_step
        if step:
            torque = step * np.round(torque / step)
        if self._most:
            torque = np.clip(torque, self._torque - self._most, self._torque + self._most)
        return torque

    def deliver(self, torque: np.ndarray) -> None:
        """Store the torques (nu,) of a tick, after clipping."""
        self._torque = torque


def units_of(scene: Scene) -> np.ndarray:
    """Units (nv,) of positions: the reach for translations, a radian for rotations."""
    sizes = np.ones(scene.compiled.nv)
    kinds = mujoco_package().mjtJoint
    slide, free = int(kinds.mjJNT_SLIDE), int(kinds.mjJNT_FREE)  # `in` finds no enum for NumPy's integers
    for joint in range(scene.compiled.njnt):
        kind, row = int(scene.compiled.jnt_type[joint]), int(scene.compiled.jnt_dofadr[joint])
        if kind in (slide, free):
            sizes[row : row + (3 if kind == free else 1)] = scene.units.length
    return sizes
