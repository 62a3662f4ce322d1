"""Controllers for simulations: the tracker of a plan, or any object with a `torque` method."""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.tracker import Tracker
from trajopt.errors import InputError, numbers_of
from trajopt.solution.solution import Solution


@runtime_checkable
class TorqueController(Protocol):
    """Interface of the controllers that a simulation asks for torques; `Tracker` is one."""

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Drive torques (nu,), N m or N, at time ``t``, s; arguments as in `Tracker.torque`."""
        ...


def controller_of(plan: Solution, reference: ReferenceTrajectory, settings: Any) -> TorqueController | None:
    """The controller that the settings choose; None for joint feedback. Raises `InputError`."""
    given = settings.controller
    if given == "joints":
        return None
    if given == "whole-body":
        gains = {} if settings.gains is None else {"gains": settings.gains}
        rate, cycles, solver = settings.control_rate, settings.cycles, settings.qp_solver
        return Tracker(plan, rate=rate, cycles=cycles, solver=solver, **gains)
    if isinstance(given, Tracker):
        ticks = len(given.reference.t), given.reference.period
        if ticks != (len(reference.t), reference.period) or given.plan.model != plan.model:
            raise InputError(
                "the Tracker of a simulation is of another plan, or has other ticks",
                f"allowed: one of this plan, rate={settings.control_rate:g}, cycles={settings.cycles}",
            )
    found: TorqueController = given
    return found


def name_of(controller: object) -> str:
    """Name of a controller in messages: its keyword or its class."""
    return f"'{controller}'" if isinstance(controller, str) else type(controller).__name__


def torque_of(
    controller: TorqueController,
    t: float,
    state: tuple[np.ndarray, np.ndarray],
    touching: np.ndarray,
    size: int,
) -> np.ndarray:
    """Torques (nu,) of a controller, called with copies. Raises `InputError` if they are invalid."""
    q, v = (part.copy() for part in state)
    torque = numbers_of(controller.torque(t, q, v, np.array(touching, dtype=bool)))
    if torque.shape != (size,) or not np.isfinite(torque).all():
        what = "are not finite" if torque.shape == (size,) else f"have shape {torque.shape}"
        raise InputError(
            f"torques of {name_of(controller)} at {t:g} s {what}", f"allowed: ({size},), finite, N m or N"
        )
    return torque
