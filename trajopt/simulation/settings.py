"""Settings of a simulation, and the scales from which all else follows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import numpy as np

from trajopt.arguments import Count, NonNegative, Positive, PositiveCount, checked
from trajopt.control.gains import TrackerGains
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.errors import InputError, numbers_of, shown
from trajopt.kinds import Range
from trajopt.robot.link_wrench import LinkWrench

# Fractions of the robot's natural time sqrt(l / g), with its reach l: step of the simulation, time in which a
# contact pushes out a penetration, and time in which feedback removes an error of a joint.
STEP, CONTACT_TIME, FEEDBACK_TIME = 1 / 500, 1 / 100, 1 / 25
LONGEST_STEP = 1e-3
# Longest step that may be requested, s: longer ones no longer resolve a robot's contacts.
LONGEST = 0.01
# Largest offset of a centre of mass or of the ground, m.
FARTHEST = 10.0
# Ranges far beyond any robot, yet numerically sound.
_Gain = Annotated[float, Range(0.0, 1e6)]
_Share = Annotated[float, Range(0.0, 1.0)]
_Offset = Annotated[float, Range(-FARTHEST, FARTHEST)]


# Feedback of single joints, by the plan's gains, or a quadratic program for the whole body at each tick
# (`trajopt.control`).
Controller = Literal["joints", "gains", "whole-body"]


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


@checked
@dataclass(frozen=True, kw_only=True)
class Impulse:
    """A horizontal impulse on the base: a constant force at its centre of mass for a short time.

    Args:
        direction: rad, counter-clockwise from the base's forward axis at that time; in a plane 0 or pi.
        size: N s.
        time: start, s from the start of the plan.
        duration: s, at least one period of the controller.
    """

    direction: float
    size: NonNegative
    time: NonNegative
    duration: Positive


@runtime_checkable
class Event(Protocol):
    """Interface of a disturbance of your own, on MuJoCo's model and data."""

    def apply(self, t: float, model: Any, data: Any) -> None:
        """Called at the start of each tick, ``t`` s from the start, before the controller is asked.

        The body that joint i of the Pinocchio model moves is called ``body<i>``. External forces
        (``xfrc_applied``) and the friction of contact pairs are reset at the start of each tick to their
        values without events; other changes stay.
        """
        ...


@checked
@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """Settings of a simulation; None stands for a value that follows from the robot. Raises `InputError`.

    Args:
        timestep: longest physics step, s.
        control_rate: of the controller, Hz.
        kp: factor on the stiffnesses of the controller "joints".
        kd: factor on its dampings.
        friction_scale: factor on all friction coefficients.
        mass_scale: factor on all masses and inertias.
        noise: standard deviation of the initial error: in reaches (m), rad, and these over the natural time.
        seed: of all noise.
        cycles: repetitions of a periodic plan.
        push: horizontal force on the base, N, to its left (planar: front) in the motion's middle tenth.
        rolling: whether contacts with a radius roll as balls or turn about their centres; None: as planned.
        controller: "joints", "gains" (of a plan that has them), "whole-body", or an object with the method of
            `TorqueController`, such as a `Tracker`.
        gains: of the controller "whole-body"; None: the default ones.
        qp_solver: of the controller "whole-body".
        impulse: another push, of any direction and time, see `Impulse`; or several.
        wrenches: on links, besides those of the plan.
        events: disturbances of your own, applied in this order, see `Event`.
        sensor_noise: standard deviation of the measured state at every tick, in the units of ``noise``.
        delay: whole ticks by which measured states and contacts are late.
        torque_step: torques are rounded to its multiples, N m (N for a sliding joint); 0 is off.
        torque_rate: fastest change of a torque, N m/s; 0 is off.
        com_offset: offset of the robot's centre of mass, made by moving that of its base link, along the
            base's forward, left and upward axes, m.
        ground_offsets: m by contact frame, by which its ground is higher than planned, along the normal.

    The plan knows nothing of the scales; plan and controller know nothing of the offsets and wrenches.
    """

    timestep: Annotated[float, Range(1e-9, LONGEST)] | None = None
    control_rate: Annotated[float, Range(1e-3, 1e6)] = 1000.0
    kp: _Gain = 1.0
    kd: _Gain = 1.0
    friction_scale: Annotated[float, Range(0.0, 1e3)] = 1.0
    mass_scale: Annotated[float, Range(1e-6, 1e6)] = 1.0
    noise: _Share = 0.0
    seed: Count = 0
    cycles: PositiveCount = 1
    push: Annotated[float, Range(-1e9, 1e9)] = 0.0
    rolling: bool | None = None
    controller: Controller | TorqueController = "joints"
    gains: TrackerGains | None = None
    qp_solver: QpSolverName = "piqp"
    impulse: Impulse | Sequence[Impulse] | None = None
    wrenches: Sequence[LinkWrench] = ()
    events: Sequence[Event] = ()
    sensor_noise: _Share = 0.0
    delay: Annotated[int, Range(0, 100)] = 0
    torque_step: _Gain = 0.0
    torque_rate: Annotated[float, Range(0.0, 1e12)] = 0.0
    com_offset: tuple[_Offset, _Offset, _Offset] = (0.0, 0.0, 0.0)
    ground_offsets: Mapping[str, _Offset] = field(default_factory=dict)

    def __post_init__(self) -> None:
        whole = "whole-body"
        for name, controller in (("kp", "joints"), ("kd", "joints"), ("qp_solver", whole), ("gains", whole)):
            value, default = getattr(self, name), SimulationSettings.__dataclass_fields__[name].default
            if value != default and self.controller != controller:
                other = name_of(self.controller)
                raise InputError(
                    f"{name} of SimulationSettings is {shown(value)}, with the controller {other}",
                    f"allowed: with the controller {controller!r}",
                )

    @property
    def impulses(self) -> tuple[Impulse, ...]:
        """All impulses, as a tuple."""
        if self.impulse is None or isinstance(self.impulse, Impulse):
            return () if self.impulse is None else (self.impulse,)
        return tuple(self.impulse)

    def step(self, natural_time: float) -> float:
        """Longest physics step, s."""
        return self.timestep or min(STEP * natural_time, LONGEST_STEP)
