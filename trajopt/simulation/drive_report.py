"""Figures of a drive: times of ticks and plans, relaxed rows, tracking of commands, falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.mpc.commands import CommandScript
from trajopt.motion.meta import jsonable

if TYPE_CHECKING:
    from trajopt.control.mpc.arm import ArmController
    from trajopt.control.mpc.controller import Controller
    from trajopt.simulation.figures import Fall
    from trajopt.simulation.record import SimulationRecord

# Tracking errors count from this time after each change of command, s.
SETTLED = 0.5


@dataclass(frozen=True, kw_only=True)
class TimeFigures:
    """Mean, median, 95th and 99th percentile of a set of times, s."""

    mean: float
    median: float
    p95: float
    p99: float

    @classmethod
    def of(cls, times: Sequence[float]) -> TimeFigures:
        """Figures of times in s; zeros if there are none."""
        values = np.array(times or [0.0])
        median, p95, p99 = np.percentile(values, [50, 95, 99])
        return cls(mean=float(values.mean()), median=float(median), p95=float(p95), p99=float(p99))

    def __str__(self) -> str:
        mean, median, p95, p99 = (1e3 * value for value in (self.mean, self.median, self.p95, self.p99))
        return f"{median:.2f} ms median, {mean:.2f} mean, {p95:.2f} / {p99:.2f} at 95 / 99 %"


@dataclass(frozen=True, kw_only=True)
class CommandErrors:
    """Rms errors of forward speed and speed to the left, m/s, and of turn rate, rad/s.

    They cover the time in which the robot walks or rolls, from `SETTLED` s after each change of command on.
    """

    speed: float
    lateral: float
    turn_rate: float

    @classmethod
    def of(cls, errors: np.ndarray) -> CommandErrors | None:
        """Rms of errors (n, 3); None if there are none."""
        if not len(errors):
            return None
        speed, lateral, turn_rate = np.sqrt((errors**2).mean(axis=0)).tolist()
        return cls(speed=speed, lateral=lateral, turn_rate=turn_rate)

    def __str__(self) -> str:
        return f"{self.speed:.3f} m/s, {self.lateral:.3f} m/s, {self.turn_rate:.3f} rad/s"


def command_errors(
    script: CommandScript, velocity: np.ndarray, period: float, periods: Mapping[str, float]
) -> tuple[CommandErrors | None, CommandErrors | None]:
    """Errors of the velocity averaged over a period of the gait, and of the velocity itself.

    Args:
        script: commands over time.
        velocity: forward speed, speed to the left, m/s, and turn rate, rad/s, at ticks (n, 3).
        period: period of the ticks, s.
        periods: periods of the gaits that count by name, s.
    """
    ends = [*script.times[1:], len(velocity) * period]
    means, values = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for begin, end, command in zip(script.times, ends, script.commands, strict=True):
        if command.gait not in periods:
            continue
        window = min(round(periods[command.gait] / period), len(velocity))
        first = round(max(begin + SETTLED, periods[command.gait] / 2) / period)
        rows = slice(first, max(first, round(end / period) - window // 2))
        wanted = np.array([command.speed, command.lateral, command.turn_rate])
        mean = [np.convolve(column, np.full(window, 1 / window), "same")[rows] for column in velocity.T]
        means.append(np.transpose(mean) - wanted)
        values.append(velocity[rows] - wanted)
    return CommandErrors.of(np.concatenate(means)), CommandErrors.of(np.concatenate(values))


@dataclass(frozen=True, kw_only=True)
class PlanFigures:
    """Figures of any drive, with legs or arms.

    ``simulated``: s, less after a fall; ``fall_time``: s. ``saturated``: share of torques that were clipped.
    ``missed``: plans that took longer than the ``deadline`` in s, which has no effect in lockstep.
    ``begun_anew``: plans that were lost, after which the next one starts afresh. ``plans_relaxed``: plans
    with violated rows, and ``violations``: the largest scaled violation, by the name of the rows, see
    `trajopt.control.mpc.plans.ControllerReport`. ``plan_times``, ``solver_times``, ``tick_times``: of whole
    plans, of their solver, and of a tick's torques; the first plan, for which the robot waits, is left out.
    """

    robot: str
    simulated: float
    fell: bool
    fall_time: float | None
    fall_reason: str
    saturated: float
    plans: int
    deadline: float
    missed: int
    begun_anew: int
    plans_relaxed: Mapping[str, int]
    violations: Mapping[str, float]
    plan_times: TimeFigures
    solver_times: TimeFigures
    tick_times: TimeFigures
    settings: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether the robot did not fall and was simulated to the end."""
        return not self.fell

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON-able values."""
        return jsonable({"passed": self.passed, **asdict(self)})

    @property
    def _lines(self) -> list[tuple[str, str]]:
        """Names and values of the figures about plans."""
        rows = [f"{name} in {n} ({self.violations[name]:.2g})" for name, n in self.plans_relaxed.items()]
        return [
            ("plans", f"{self.plans}, {self.missed} longer than {1e3 * self.deadline:g} ms"),
            ("plans begun anew", f"{self.begun_anew}"),
            ("plans relaxed, most, scaled", ", ".join(rows) or RELAXED[0]),
            ("time of a plan", str(self.plan_times)),
            ("of its solver", str(self.solver_times)),
            ("of a tick's torques", str(self.tick_times)),
            ("torques cut off", f"{100 * self.saturated:.2f} %"),
        ]


def plan_figures(
    controller: Controller | ArmController, record: SimulationRecord, period: float, fall: Fall | None
) -> dict[str, Any]:
    """Fields of `PlanFigures` from a controller's counts and a simulation with ticks of ``period`` s."""
    counts, settings = controller.report, controller.settings
    return {
        "robot": controller.robot.name,
        "simulated": len(record.feet) * period,
        "fell": fall is not None,
        "fall_time": None if fall is None else fall.time,
        "fall_reason": "" if fall is None else fall.why,
        "saturated": float(record.saturated.mean()),
        "plans": len(counts.planning),
        "deadline": settings.delay,
        "missed": counts.missed,
        "begun_anew": counts.anew,
        "plans_relaxed": {name: count for name, count in counts.relaxed.items() if count},
        "violations": dict(counts.violations),
        "plan_times": TimeFigures.of(counts.planning[1:]),
        "solver_times": TimeFigures.of(counts.solving[1:]),
        "tick_times": TimeFigures.of(counts.following),
        "settings": asdict(settings),
    }


@dataclass(frozen=True, kw_only=True)
class DriveReport(PlanFigures):
    """Figures of a drive; `trajopt.simulation.figures.FallTest` judges falls at the commanded height.

    Args:
        duration: requested duration, s.
        distance: distance that the base moved along the ground, m.
        mean_errors: velocity errors averaged over gait periods, see `command_errors`; None if no time counts.
        errors: errors of the velocity itself, likewise.
        relaxed: ticks by what was relaxed, see `trajopt.control.inverse_dynamics.RELAXED`.
        slack: largest violation in these ticks, natural units.
        gaits: periods of the gaits by name, s.
        script: the commands.
    """

    duration: float
    distance: float
    mean_errors: CommandErrors | None
    errors: CommandErrors | None
    relaxed: Mapping[str, int]
    slack: float
    gaits: Mapping[str, float]
    script: CommandScript

    def table(self) -> str:
        """The figures as readable text, one a line."""
        relaxed = [f"{what} in {count}" for what, count in self.relaxed.items() if what != RELAXED[0]]
        lines = [
            ("driven", f"{self.simulated:.3f} s of {self.duration:.3f} s, {self.distance:.2f} m"),
            ("speed, lateral, turn, rms", str(self.mean_errors or "-")),
            ("without a mean over periods", str(self.errors or "-")),
            *self._lines,
            ("ticks relaxed", f"{', '.join(relaxed) or RELAXED[0]}, slack {self.slack:.2g} in natural units"),
        ]
        text = [f"{name:27} {value}" for name, value in lines]
        end = f"it fell at {self.fall_time:.3f} s: {self.fall_reason}" if self.fell else "it did not fall"
        return "\n".join([*text, end])
