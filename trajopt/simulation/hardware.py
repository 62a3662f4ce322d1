"""What lies between a controller and the robot: noise and delay of sensors, resolution and rate of drives."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.settings import SimulationSettings

# The noise of sensors is drawn apart from the start's, which has the seed alone.
SENSORS = 1


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What sensors tell at a tick: qpos (nq',), qvel (nv,) in MuJoCo's coordinates, touching (nc,)."""

    qpos: np.ndarray
    qvel: np.ndarray
    touching: np.ndarray


class Hardware:
    """Sensors and drives of one simulation, with what they remember.

    Args:
        model: MuJoCo's, compiled.
        settings: of the simulation.
        units: (nv,) of positions; rates are these over ``time``, the natural time in s.
        time: see ``units``.
        period: of the controller, s.
        torque: (nu,) before the first tick.
    """

    def __init__(
        self,
        model: Any,
        settings: SimulationSettings,
        *,
        units: np.ndarray,
        time: float,
        period: float,
        torque: np.ndarray,
    ) -> None:
        self._model, self._settings = model, settings
        self._units, self._time, self._most = units, time, settings.torque_rate * period
        self._generator = np.random.default_rng((settings.seed, SENSORS))
        self._history: deque[Measurement] = deque(maxlen=settings.delay + 1)
        self._torque = torque.copy()

    def copy(self) -> Hardware:
        """Sensors and drives that go on as these would."""
        duplicate = copy.copy(self)
        duplicate._generator, duplicate._history = copy.deepcopy(self._generator), self._history.copy()
        return duplicate

    def measure(self, qpos: np.ndarray, qvel: np.ndarray, touching: np.ndarray) -> Measurement:
        """Measure a state; returns what the controller knows: the state ``delay`` ticks ago, or the first."""
        measurement = Measurement(qpos=qpos.copy(), qvel=qvel.copy(), touching=touching)
        if self._settings.sensor_noise:
            size = self._settings.sensor_noise * self._units
            error = size * self._generator.standard_normal(self._model.nv)
            mujoco_package().mj_integratePos(self._model, measurement.qpos, error, 1.0)
            measurement.qvel[:] += size * self._generator.standard_normal(self._model.nv) / self._time
        self._history.append(measurement)
        return self._history[0]

    def command(self, wanted: np.ndarray) -> np.ndarray:
        """Torques (nu,) for a command: rounded, and as far as they can change from the last ones."""
        torque, step = wanted, self._settings.torque_step
        if step:
            torque = step * np.round(torque / step)
        if self._most:
            torque = np.clip(torque, self._torque - self._most, self._torque + self._most)
        return torque

    def deliver(self, torque: np.ndarray) -> None:
        """Remember the torques (nu,) of a tick, after their limits."""
        self._torque = torque
