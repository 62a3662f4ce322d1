"""Figures of a drive: times of ticks and plans, relaxed rows, tracking of commands, falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.certify.figures import figure
from trajopt.control.mpc.arm import ArmController
from trajopt.control.mpc.commands import Command, CommandScript
from trajopt.control.mpc.controller import Controller
from trajopt.simulation.figures import Fall
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.report import MotionReport, relaxed_ticks

CommandLog = Sequence[tuple[float, Command]]
# Tracking errors count from this time after each change of command, s.
SETTLED = 0.5


@dataclass(frozen=True, kw_only=True)
class TimeFigures:
    """Mean, median, 95th and 99th percentile of a set of times, s."""

    mean: float
    median: float = figure("median", "ms", scale=1e3)
    p95: float
    p99: float = figure("99 %", "ms", scale=1e3)

    @classmethod
    def of(cls, times: Sequence[float]) -> TimeFigures:
        """Figures of times in s; zeros if there are none."""
        values = np.array(times or [0.0])
        median, p95, p99 = np.percentile(values, [50, 95, 99])
        return cls(mean=float(values.mean()), median=float(median), p95=float(p95), p99=float(p99))


@dataclass(frozen=True, kw_only=True)
class CommandErrors:
    """Rms errors of forward speed and speed to the left, m/s, and of turn rate, rad/s.

    They cover the time in which the robot walks or rolls, from `SETTLED` s after each change of command on.
    """

    speed: float = figure("forward", "m/s")
    lateral: float = figure("to the left", "m/s")
    turn_rate: float = figure("turn rate", "rad/s")

    @classmethod
    def of(cls, errors: np.ndarray) -> CommandErrors | None:
        """Rms of errors (n, 3); None if there are none."""
        if not len(errors):
            return None
        speed, lateral, turn_rate = np.sqrt((errors**2).mean(axis=0)).tolist()
        return cls(speed=speed, lateral=lateral, turn_rate=turn_rate)


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


def since(log: Sequence[tuple[float, Any]], offset: float) -> list[tuple[float, Any]]:
    """The entries of a log in effect from ``offset`` s on, with times relative to it; the first is at 0."""
    times = [max(time - offset, 0.0) for time, _ in log]
    first = sum(time == 0.0 for time in times) - 1
    return [(time, sent) for time, (_, sent) in zip(times, log, strict=True)][first:]


@dataclass(frozen=True, kw_only=True)
class PlanFigures(MotionReport):
    """Figures of any drive, with legs or arms.

    ``simulated``: s, less after a fall. ``saturated``: share of torques that were clipped. ``missed``: plans
    that took longer than the ``deadline`` in s, which has no effect in lockstep. ``begun_anew``: plans that
    were lost, after which the next one starts afresh. ``plans_relaxed``: plans with violated rows, and
    ``violations``: the largest scaled violation, by the name of the rows, see
    `trajopt.control.mpc.plans.ControllerReport`. ``relaxed``: ticks by what their programs relaxed, see
    `trajopt.control.inverse_dynamics.RELAXED`, and ``slack``: the largest violation in them, natural units.
    ``plan_times``, ``solver_times``, ``tick_times``: of whole plans, of their solver, and of a tick's
    torques; the first plan, for which the robot waits, is left out.
    """

    simulated: float = figure("driven", "s")
    plans: int = figure("plans")
    deadline: float = figure("time until a plan is used", "ms", scale=1e3)
    missed: int = figure("plans that took longer")
    begun_anew: int = figure("plans begun anew")
    plans_relaxed: Mapping[str, int] = figure("plans relaxed")
    violations: Mapping[str, float] = figure("violation", "scaled", applies=lambda r: r.plans_relaxed)
    relaxed: Mapping[str, int] = figure("ticks by relaxation")
    slack: float = figure("ticks, slack", "natural")
    plan_times: TimeFigures = figure("time of a plan")
    solver_times: TimeFigures = figure("time of its solver")
    tick_times: TimeFigures = figure("time of a tick's torques")
    saturated: float = figure("torques cut off", "%", scale=100.0)
    settings: Mapping[str, Any]


def plan_figures(
    controller: Controller | ArmController, record: SimulationRecord, period: float, fall: Fall | None
) -> dict[str, Any]:
    """Fields of `PlanFigures` from a controller's counts and a simulation with ticks of ``period`` s."""
    counts, settings = controller.report, controller.settings
    return {
        "robot": controller.robot.name,
        "simulated": len(record.feet) * period,
        **MotionReport.of_fall(fall),
        "saturated": float(record.saturated.mean()),
        "plans": len(counts.planning),
        "deadline": settings.delay,
        "missed": counts.missed,
        "begun_anew": counts.anew,
        "plans_relaxed": {name: count for name, count in counts.relaxed.items() if count},
        "violations": dict(counts.violations),
        "relaxed": relaxed_ticks(counts.ticks),
        "slack": counts.slack,
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
        gaits: periods of the gaits by name, s.
        script: the commands.
    """

    duration: float
    distance: float = figure("distance", "m")
    mean_errors: CommandErrors | None = figure("rms error of mean velocity")
    errors: CommandErrors | None = figure("rms error of velocity")
    gaits: Mapping[str, float]
    script: CommandScript
