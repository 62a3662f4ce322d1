"""Settings of a simulation, and the scales from which everything else follows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from trajopt.arguments import Count, NonNegative, Positive, PositiveCount, checked
from trajopt.control.gains import TrackerGains
from trajopt.control.quadratic_programs import QpSolverName
from trajopt.errors import InputError, shown
from trajopt.kinds import Range
from trajopt.simulation.controllers import TorqueController, name_of

# Shares of the robot's natural time sqrt(l / g), l its reach: the step of the simulation, the time in which
# a contact pushes a penetration out again, and the time in which the feedback takes out an error of a joint.
STEP, CONTACT_TIME, FEEDBACK_TIME = 1 / 500, 1 / 100, 1 / 25
LONGEST_STEP = 1e-3
# Longest step that may be asked for, s: with longer ones a robot's contacts are no longer resolved.
LONGEST = 0.01
# Largest offset of a centre of mass or of the ground, m.
FARTHEST = 10.0
# Ranges are far beyond any robot, and still numerically sound.
_Gain = Annotated[float, Range(0.0, 1e6)]
_Share = Annotated[float, Range(0.0, 1.0)]
_Offset = Annotated[float, Range(-FARTHEST, FARTHEST)]


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


@checked
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
        """All of ``impulse``."""
        if self.impulse is None or isinstance(self.impulse, Impulse):
            return () if self.impulse is None else (self.impulse,)
        return tuple(self.impulse)

    def step(self, natural_time: float) -> float:
        """Longest step of the physics in s."""
        return self.timestep or min(STEP * natural_time, LONGEST_STEP)
