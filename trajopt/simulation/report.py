"""The report of a simulation: figures, their thresholds, and their text."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.tick_request import TickCounts
from trajopt.motion.meta import jsonable

# A plan is tracked if its base ends within this fraction of the reach and within this angle, rad; on a fixed
# base, if no joint error ever exceeds the last, rad or m.
BASE_PASSED, TURN_PASSED, JOINT_PASSED = 0.05, 0.2, 0.1


@dataclass(frozen=True, kw_only=True)
class ContactReport:
    """One contact over the plan: touchdown errors (s, positive if late), missed ones, largest travel (m)."""

    frame: str
    touchdowns: tuple[float, ...]
    missed: int
    travel: float | None


@dataclass(frozen=True, kw_only=True)
class TickReport:
    """Quadratic programs of a whole-body controller: ticks, total iterations, and time per tick, s.

    relaxed: number of ticks by what they relaxed, see `trajopt.control.inverse_dynamics.RELAXED`. slack:
    largest violation of a relaxed row, see `trajopt.control.inverse_dynamics.TickResult`.
    """

    ticks: int
    iterations: int
    time_mean: float
    time_99: float
    relaxed: dict[str, int]
    slack: float

    @classmethod
    def of(cls, counts: TickCounts) -> TickReport:
        """The report of a tracker's counts."""
        times = np.array(counts.times or [0.0])
        return cls(
            ticks=counts.ticks,
            iterations=counts.iterations,
            time_mean=float(times.mean()),
            time_99=float(np.percentile(times, 99)),
            relaxed={name: count for name, count in zip(RELAXED, counts.relaxed, strict=True) if count},
            slack=counts.slack,
        )

    def __str__(self) -> str:
        relaxations = [f"{what} in {count}" for what, count in self.relaxed.items() if what != RELAXED[0]]
        times = f"{1e3 * self.time_mean:.2f} ms in the mean, {1e3 * self.time_99:.2f} ms at 99 %"
        relaxed = f"relaxed: {', '.join(relaxations) or RELAXED[0]}, slack {self.slack:.2g} in natural units"
        return f"{self.ticks}, {times}; {relaxed}"


@dataclass(frozen=True, kw_only=True)
class SimulationReport:
    """Figures of a simulation; base and joint errors are over the plan, without the hold after it.

    Args:
        reach, duration, held: m; s of the plan, and of the hold after it.
        fell, fall_time, fall_reason: within both; the time in s.
        base_error_*, base_turn_*: m and rad, None on a fixed base; base_error_held: after the hold.
        joint_error_*: rad or m. saturated: fraction of torques that were clipped.
        touchdown_error, missed, swing_load: largest, s; touchdowns that never came; load in mid-swing, s.
        slips, slip_travel: stances with more travel than `figures.SLIP`; the largest travel, m.
        force_error: rms, over the weight. obstacle_hit: a link touched an obstacle.
        controller: quadratic programs of a whole-body controller.
    """

    problem: str
    robot: str
    reach: float
    duration: float
    held: float
    timestep: float
    feedback_rate: float
    fell: bool
    fall_time: float | None
    fall_reason: str
    base_error_end: float | None
    base_error_max: float | None
    base_error_rms: float | None
    base_error_held: float | None
    base_turn_end: float | None
    base_turn_max: float | None
    joint_error_end: float
    joint_error_max: float
    joint_error_rms: float
    saturated: float
    touchdown_error: float | None
    missed: int
    swing_load: float
    slips: int
    slip_travel: float | None
    force_error: float | None
    obstacle_hit: bool
    contacts: tuple[ContactReport, ...]
    controller: TickReport | None
    notes: tuple[str, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """Exceeded thresholds, in words; empty for a plan that is tracked."""
        failures = [f"it fell at {self.fall_time:.3f} s: {self.fall_reason}"] if self.fell else []
        for name, value, threshold, unit in self._judged():
            if value is not None and not value <= threshold:
                failures.append(f"{name} {value:.4g} {unit} > {threshold:.4g} {unit}")
        return tuple(failures + (["it touched an obstacle"] if self.obstacle_hit else []))

    def _judged(self) -> tuple[tuple[str, float | None, float, str], ...]:
        if self.base_error_end is None:
            return (("joint error", self.joint_error_max, JOINT_PASSED, "rad"),)
        return (
            ("base error at the end", self.base_error_end, BASE_PASSED * self.reach, "m"),
            ("base turned at the end by", self.base_turn_end, TURN_PASSED, "rad"),
            ("base error after the hold", self.base_error_held, BASE_PASSED * self.reach, "m"),
        )

    @property
    def passed(self) -> bool:
        """Whether the plan is tracked: no fall, no obstacle touched, errors within the thresholds."""
        return not self.failures

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures."""
        return jsonable({"passed": self.passed, "failures": self.failures, **asdict(self)})

    def table(self) -> str:
        """Human-readable figures, one per line."""
        lines = [
            ("simulated", f"{self.duration:.3f} s" + (f", held {self.held:.3f} s" if self.held else "")),
            ("base at the end", _pair(self.base_error_end, self.base_turn_end)),
            ("base, largest", _pair(self.base_error_max, self.base_turn_max)),
            ("base after the hold", _length(self.base_error_held) if self.held else "-"),
            ("joints, rms / largest", f"{self.joint_error_rms:.2e} / {self.joint_error_max:.2e} rad"),
            ("torques cut off", f"{100 * self.saturated:.2f} %"),
            ("contact forces off, rms", _part(self.force_error)),
            ("touchdowns, largest error", _time(self.touchdown_error)),
            ("touchdowns that never came", str(self.missed)),
            ("load in mid swing", _time(self.swing_load)),
            ("slips, largest travel", f"{self.slips}, {_length(self.slip_travel)}"),
            ("ticks of the controller", "-" if self.controller is None else str(self.controller)),
        ]
        moving = self.base_error_end is not None
        unused: tuple[str, ...] = () if moving else ("base", "load")
        unused += () if self.contacts else ("contact", "touchdowns", "slips", "load")
        shown = [line for line in lines if not line[0].startswith(unused)] if unused else lines
        text = [f"{name:27} {value}" for name, value in shown if value != "-"]
        text += [f"note: {note}" for note in self.notes]
        return "\n".join([*text, "tracked" if self.passed else "not tracked: " + "; ".join(self.failures)])


def _length(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.1f} mm"


def _time(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.1f} ms"


def _part(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} % of the weight"


def _pair(length: float | None, angle: float | None) -> str:
    return "-" if length is None or angle is None else f"{1e3 * length:.1f} mm, {angle:.2e} rad"
