"""Settings of a simulation, and the scales from which everything else follows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

import numpy as np

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.control.gains import TrackerGains
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.errors import InputError, not_among, require_finite, shown
from trajopt.simulation.controllers import TorqueController, name_of

# Shares of the robot's natural time sqrt(l / g), l its reach: the step of the simulation, the time in which
# a contact pushes a penetration out again, and the time in which the feedback takes out an error of a joint.
STEP, CONTACT_TIME, FEEDBACK_TIME = 1 / 500, 1 / 100, 1 / 25
LONGEST_STEP = 1e-3
# Longest step that may be asked for, s: with longer ones a robot's contacts are no longer resolved.
LONGEST = 0.01
# Allowed ranges: far beyond any robot, and still numerically sound.
ALLOWED = {
    "timestep": (1e-9, LONGEST),
    "control_rate": (1e-3, 1e6),
    "kp": (0.0, 1e6),
    "kd": (0.0, 1e6),
    "friction_scale": (0.0, 1e3),
    "mass_scale": (1e-6, 1e6),
    "noise": (0.0, 1.0),
    "push": (-1e9, 1e9),
    "sensor_noise": (0.0, 1.0),
    "delay": (0, 100),
    "torque_step": (0.0, 1e6),
    "torque_rate": (0.0, 1e12),
}
# Largest offset of a centre of mass or of the ground, m.
FARTHEST = 10.0
# Settings that are checked separately.
CHECKED_APART = (
    "rolling", "controller", "gains", "qp_solver", "impulse", "com_offset", "ground_offsets",
)  # fmt: skip


# Feedback of single joints, or a quadratic program for the whole body at each tick (`trajopt.control`).
Controller = Literal["joints", "whole-body"]


@checked
@dataclass(frozen=True, kw_only=True)
class Impulse:
    """A level impulse on the base: a constant force at its centre of mass for a short time.

    Args:
        direction: rad, counter-clockwise from the base's forward axis at that time; in a plane 0 or pi.
        size: N s.
        time: of its begin, s from the start of the plan.
        duration: s, at least one period of the controller.
    """

    direction: float
    size: NonNegative
    time: NonNegative
    duration: Positive


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """Settings of a simulation; None is a value that follows from the robot.

    timestep: longest step of the physics, s. control_rate: of the controller, Hz. kp, kd: factors on the
    gains. friction_scale, mass_scale: factors on all coefficients of friction and on all masses and
    inertias, of which the plan knows nothing. noise: standard deviation of the start's error, in reaches
    (m), rad, and their rates over the natural time. seed: of the noise. cycles: of a periodic plan. push: N,
    level on the base for a tenth of the motion, in its middle, to its left; in a plane to its front.
    impulse: another push, of any direction and time, see `Impulse`, or several.
    rolling: whether contacts with a radius are balls fixed to their links, which roll, or turn about their
    centres; None: each as in the plan. controller: see `Controller`, or an object with the ``torque`` of a
    `Tracker`, see `TorqueController`; ``kp`` and ``kd`` are of "joints", gains, None for the usual ones, and
    qp_solver, which solves the programs, of "whole-body".

    Of the hardware: sensor_noise: standard deviation of the measured state at every tick, in the units of
    ``noise``. delay: whole ticks by which the measured state and contacts are late. torque_step: torques are
    rounded to its multiples, N m (N of a joint that slides); torque_rate: N m/s, the fastest change of a
    torque; 0 is off for both.
    com_offset: m, along the base's forward, left and upward axes: the robot's centre of mass is off by this,
    because that of its base link is. ground_offsets: m by contact frame: what this contact stands on is so
    much higher than planned, along its normal. The plan and the controller know of neither.
    Raises `InputError`.
    """

    timestep: float | None = None
    control_rate: float = 1000.0
    kp: float = 1.0
    kd: float = 1.0
    friction_scale: float = 1.0
    mass_scale: float = 1.0
    noise: float = 0.0
    seed: int = 0
    cycles: int = 1
    push: float = 0.0
    rolling: bool | None = None
    controller: Controller | TorqueController = "joints"
    gains: TrackerGains | None = None
    qp_solver: QpSolverName = "piqp"
    impulse: Impulse | Sequence[Impulse] | None = None
    sensor_noise: float = 0.0
    delay: int = 0
    torque_step: float = 0.0
    torque_rate: float = 0.0
    com_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ground_offsets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.rolling, bool | None):
            raise InputError(
                f"rolling of a simulation is {shown(self.rolling)}", "allowed: True, False or None"
            )
        words = get_args(Controller)
        if isinstance(self.controller, str) and self.controller not in words:
            raise not_among(words, self.controller, f"controller of a simulation is '{self.controller}'")
        if isinstance(self.controller, type) or not isinstance(self.controller, str | TorqueController):
            raise InputError(
                f"controller of a simulation is {shown(self.controller)}",
                f"allowed: {', '.join(words)}, or an object with torque(t, q, v, touching), as a Tracker",
            )
        if not isinstance(self.gains, TrackerGains | None):
            raise InputError(
                f"gains of a simulation is {shown(self.gains)}", "allowed: a TrackerGains or None"
            )
        if self.qp_solver not in get_args(QpSolverName):
            raise not_among(
                get_args(QpSolverName),
                str(self.qp_solver),
                f"qp_solver of a simulation is {shown(self.qp_solver)}",
            )
        if not isinstance(self.impulse, Sequence | Impulse | None) or not all(
            isinstance(each, Impulse) for each in self.impulses
        ):
            raise InputError(
                f"impulse of a simulation is {shown(self.impulse)}", "allowed: an Impulse, several, or None"
            )
        object.__setattr__(self, "com_offset", _com_offset(self.com_offset))
        object.__setattr__(self, "ground_offsets", _ground_offsets(self.ground_offsets))
        for name in (setting.name for setting in fields(self) if setting.name not in CHECKED_APART):
            value = getattr(self, name)
            if value is None and name == "timestep":
                continue
            require_finite(f"{name} of a simulation", value)
            least, most = ALLOWED.get(name, (-math.inf, math.inf))
            if not least <= value <= most:
                raise InputError(f"{name} of a simulation is {value:g}", f"allowed: {least:g} to {most:g}")
        for name, least in (("cycles", 1), ("seed", 0), ("delay", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(
                    f"{name} of a simulation is {shown(value)}", f"allowed: a whole number >= {least}"
                )

        self._require_effect()

    def _require_effect(self) -> None:
        """Raise `InputError` for settings that are of the other controller."""
        whole = "whole-body"
        for name, controller in (("kp", "joints"), ("kd", "joints"), ("qp_solver", whole), ("gains", whole)):
            value, default = getattr(self, name), SimulationSettings.__dataclass_fields__[name].default
            if value != default and self.controller != controller:
                other = name_of(self.controller)
                raise InputError(
                    f"{name} of a simulation is {shown(value)}, with the controller {other}",
                    f"allowed: with the controller {controller!r}",
                )

    @property
    def impulses(self) -> tuple[Impulse, ...]:
        """All of ``impulse``."""
        if self.impulse is None or isinstance(self.impulse, Impulse):
            return () if self.impulse is None else (self.impulse,)
        return tuple(self.impulse)

    def step(self, natural_time: float) -> float:
        """Longest step of the physics in s."""
        return self.timestep or min(STEP * natural_time, LONGEST_STEP)


def _com_offset(value: Any) -> tuple[float, float, float]:
    """Three finite numbers. Raises `InputError`."""
    if isinstance(value, str) or not isinstance(value, list | tuple | np.ndarray) or len(value) != 3:
        raise InputError(f"com_offset of a simulation is {shown(value)}", "allowed: three numbers, m")
    for axis, number in zip("xyz", value, strict=True):
        _require_length(f"{axis} of com_offset of a simulation", number)
    x, y, z = (float(number) for number in value)
    return x, y, z


def _ground_offsets(value: Any) -> dict[str, float]:
    """Finite numbers by name, a copy. Raises `InputError`."""
    if not isinstance(value, Mapping):
        raise InputError(f"ground_offsets of a simulation is {shown(value)}", "allowed: m by contact frame")
    for name, number in value.items():
        _require_length(f"ground_offsets of a simulation for '{name}'", number)
    return {str(name): float(number) for name, number in value.items()}


def _require_length(what: str, value: Any) -> None:
    require_finite(what, value)
    if not abs(value) <= FARTHEST:
        raise InputError(f"{what} is {value:g}", f"allowed: {-FARTHEST:g} to {FARTHEST:g}")
