"""Reports of simulated motions: falls and their figures; those of a simulated plan, with their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from trajopt.certify.figures import FigureReport, figure
from trajopt.control.inverse_dynamics import RELAXED
from trajopt.control.tick_request import TickCounts
from trajopt.simulation.figures import Fall

# A plan is tracked if its base ends within this fraction of the reach and within this angle, rad; on a fixed
# base, if no joint error ever exceeds the last, rad or m.
BASE_PASSED, TURN_PASSED, JOINT_PASSED = 0.05, 0.2, 0.1


@dataclass(frozen=True, kw_only=True)
class MotionReport(FigureReport):
    """Whether a simulated robot fell.

    Args:
        robot: its name.
        fell: whether it fell, the simulation diverged or the controller failed.
        fall_time: s.
        fall_reason: in words.
    """

    DERIVED: ClassVar[tuple[str, ...]] = ("passed",)
    # Words for success, for a fall, and before failures.
    WORDS: ClassVar[tuple[str, str, str]] = ("it did not fall", "it fell", "")

    robot: str
    fell: bool
    fall_time: float | None
    fall_reason: str

    @staticmethod
    def of_fall(fall: Fall | None) -> dict[str, Any]:
        """The fields of a fall, or of none."""
        time, why = (None, "") if fall is None else (fall.time, fall.why)
        return {"fell": fall is not None, "fall_time": time, "fall_reason": why}

    @property
    def failures(self) -> tuple[str, ...]:
        """What is not as required, in words."""
        fall = [f"{self.WORDS[1]} at {self.fall_time:.3f} s: {self.fall_reason}"] if self.fell else []
        return (
            *fall,
            *(
                f"{each.text} {each.value:.4g} {each.unit} > {each.limit:.4g} {each.unit}"
                for each in self.figures()
                if each.beyond
            ),
        )

    @property
    def passed(self) -> bool:
        """Whether the robot did not fall, and all judged figures are within their limits."""
        return not self.failures

    @override
    def table(self) -> str:
        failures, (good, _, bad) = "; ".join(self.failures), self.WORDS
        return f"{super().table()}\n{bad + failures if failures else good}"


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

    ticks: int = figure("")
    iterations: int
    time_mean: float = figure("mean time", "ms", scale=1e3)
    time_99: float = figure("99 % of times", "ms", scale=1e3)
    relaxed: dict[str, int] = figure("by relaxation")
    slack: float = figure("slack", "natural")

    @classmethod
    def of(cls, counts: TickCounts) -> TickReport:
        """The report of a tracker's counts."""
        times = np.array(counts.times or [0.0])
        return cls(
            ticks=counts.ticks,
            iterations=counts.iterations,
            time_mean=float(times.mean()),
            time_99=float(np.percentile(times, 99)),
            relaxed=relaxed_ticks(counts.relaxed),
            slack=counts.slack,
        )


def relaxed_ticks(counts: Sequence[int]) -> dict[str, int]:
    """Numbers of ticks by what they relaxed, from those in the order of `RELAXED`."""
    return {name: count for name, count in zip(RELAXED, counts, strict=True) if count}


def _near(report: SimulationReport) -> float:
    return BASE_PASSED * report.reach


def _near_joints(report: SimulationReport) -> float | None:
    return JOINT_PASSED if report.base_error_end is None else None


def _touches(report: SimulationReport) -> bool:
    return bool(report.contacts)


@dataclass(frozen=True, kw_only=True)
class SimulationReport(MotionReport):
    """Figures of a simulation; base and joint errors are over the plan, without the hold after it.

    Args:
        reach, duration, held: m; s of the plan, and of the hold after it.
        base_error_*, base_turn_*: m and rad, None on a fixed base; base_error_held: after the hold.
        joint_error_*: rad or m. saturated: fraction of torques that were clipped.
        touchdown_error, missed, swing_load: largest, s; touchdowns that never came; load in mid-swing, s.
        slips, slip_travel: stances with more travel than `figures.SLIP`; the largest travel, m.
        force_error: rms, over the weight. obstacle_hit: a link touched an obstacle.
        controller: quadratic programs of a whole-body controller.
    """

    DERIVED: ClassVar[tuple[str, ...]] = ("passed", "failures")
    WORDS: ClassVar[tuple[str, str, str]] = ("tracked", "it fell", "not tracked: ")

    problem: str
    reach: float
    duration: float = figure("simulated", "s")
    held: float = figure("held after it", "s")
    timestep: float
    feedback_rate: float
    base_error_end: float | None = figure("base error at the end", "m", limit=_near)
    base_turn_end: float | None = figure("base turned at the end by", "rad", limit=lambda _: TURN_PASSED)
    base_error_held: float | None = figure("base error after the hold", "m", limit=_near)
    base_error_max: float | None = figure("base error, largest", "m")
    base_error_rms: float | None
    base_turn_max: float | None = figure("base turned by, largest", "rad")
    joint_error_end: float
    joint_error_rms: float = figure("joint error, rms", "rad")
    joint_error_max: float = figure("joint error", "rad", limit=_near_joints)
    saturated: float = figure("torques cut off", "%", scale=100.0)
    force_error: float | None = figure("contact forces off, rms", "% of weight", scale=100.0)
    touchdown_error: float | None = figure("touchdowns, largest error", "ms", scale=1e3)
    missed: int = figure("touchdowns that never came", applies=_touches)
    swing_load: float = figure("load in mid swing", "ms", scale=1e3, applies=_touches)
    slips: int = figure("slips", applies=_touches)
    slip_travel: float | None = figure("slips, largest travel", "mm", scale=1e3)
    obstacle_hit: bool
    contacts: tuple[ContactReport, ...]
    controller: TickReport | None = figure("ticks")
    notes: tuple[str, ...]

    @property
    @override
    def failures(self) -> tuple[str, ...]:
        return super().failures + (("it touched an obstacle",) if self.obstacle_hit else ())
