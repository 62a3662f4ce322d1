"""The interface of controllers: any object with a `torque` method."""

from typing import Protocol, runtime_checkable

import numpy as np

from trajopt.errors import InputError, numbers_of


@runtime_checkable
class TorqueController(Protocol):
    """Interface of the controllers that a simulation asks for torques; `Tracker` is one."""

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) of the drives, N m or N; arguments as in `Tracker.torque`."""
        ...


def name_of(controller: object) -> str:
    """Name of a controller in messages: its keyword or its class."""
    return f"'{controller}'" if isinstance(controller, str) else type(controller).__name__


class GivenController:
    """A user's controller, whose torques (nu,) are checked, and which cannot change the simulated state."""

    def __init__(self, controller: TorqueController, nu: int) -> None:
        self._controller, self._nu = controller, nu

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) of the controller. Raises `InputError` if they are invalid."""
        torque = numbers_of(self._controller.torque(t, q, v, np.array(touching, dtype=bool)))
        if torque.shape != (self._nu,) or not np.isfinite(torque).all():
            what = "are not finite" if torque.shape == (self._nu,) else f"have shape {torque.shape}"
            raise InputError(
                f"torques of {name_of(self._controller)} at {t:g} s {what}",
                f"allowed: ({self._nu},), finite, N m or N",
            )
        return torque
