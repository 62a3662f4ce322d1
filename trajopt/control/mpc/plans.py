"""When plans are made and used, and the solver steps that make them, for legs and arms alike."""

from __future__ import annotations

import math
import time as clocks
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from trajopt import _engine
from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.control.inverse_dynamics import RELAXED, TickResult
from trajopt.control.mpc.horizon import Horizon
from trajopt.control.mpc.motion import HorizonMotion

# A plan with scaled multipliers or variables above this is lost, and the next one starts afresh.
LOST = 1e6
# So is a plan whose scaled row residual is above this after its last step.
UNUSABLE = 1.0
# Distance of a fresh start from its bounds, scaled, and factor on the number of its steps.
PUSH, FRESH = 1e-2, 4


@checked
@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """Steps of the interior-point method at a tick.

    Args:
        steps: least number of steps.
        most_steps: largest number of steps, taken while residuals are above ``tolerance``.
        changed_steps: largest number of steps after the pattern of contacts has changed.
        tolerance: scaled residual of rows and optimality at which a tick ends.
        barrier: least barrier parameter.
        most_barrier: largest barrier parameter, up to which short steps raise it.
        seconds: time after which no further step begins, s; 0 is no limit.
    """

    steps: PositiveCount = 2
    most_steps: PositiveCount = 4
    changed_steps: PositiveCount = 6
    tolerance: Positive = 1e-2
    barrier: Positive = 1e-4
    most_barrier: Positive = 1e-2
    seconds: float = 0.0

    def fresh(self, horizon: Horizon, x: np.ndarray) -> _engine.Iterate:
        """An iterate from scaled variables, with fresh multipliers and slacks."""
        zero = np.zeros(len(horizon.compliance))
        return horizon.solver.complete(x, zero, *horizon.bounds, self.barrier, PUSH)

    def solve(
        self, horizon: Horizon, iterate: _engine.Iterate, most: int
    ) -> tuple[_engine.Iterate, list[_engine.StepReport]]:
        """The iterate after at most ``most`` steps, and their reports; sets the horizon's fixed start."""
        node = horizon.layout.node(0)
        iterate["x"][node] = horizon.lower_x[node]
        return horizon.solver.steps(
            iterate,
            *horizon.bounds,
            horizon.compliance,
            self.barrier,
            self.most_barrier,
            tolerance=self.tolerance,
            seconds=self.seconds,
            steps=most,
            least_steps=min(self.steps, most),
        )


def is_lost(iterate: _engine.Iterate, reports: list[_engine.StepReport]) -> bool:
    """Whether a plan must not be used, and the next one has to start afresh."""
    worst = max(float(np.abs(iterate["y"]).max()), float(np.abs(iterate["x"]).max()))
    kept = math.isfinite(worst) and worst < LOST and reports[-1]["after"] < UNUSABLE
    return not (kept and reports[-1]["primal_step"] > 0)


@dataclass
class ControllerReport:
    """Times and counts of all ticks.

    Args:
        planning: computation time of each plan, s.
        solving: time of the solver alone, s.
        following: time of each tick's torques, s.
        steps: solver steps of each plan.
        primal: row residual of each plan.
        missed: plans that were not ready in time.
        anew: plans that were lost, see `is_lost`.
        relaxed: plans with scaled violations above `VIOLATED`, by the name of the rows.
        violations: largest scaled violation, by the name of the rows.
        ticks: ticks by what they relaxed, in the order of `trajopt.control.inverse_dynamics.RELAXED`.
        slack: largest violation of a relaxed row in any tick, natural units.
    """

    planning: list[float] = field(default_factory=list)
    solving: list[float] = field(default_factory=list)
    following: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    primal: list[float] = field(default_factory=list)
    missed: int = 0
    anew: int = 0
    relaxed: dict[str, int] = field(default_factory=dict)
    violations: dict[str, float] = field(default_factory=dict)
    ticks: list[int] = field(default_factory=lambda: [0] * len(RELAXED))
    slack: float = 0.0

    def followed(self, result: TickResult) -> None:
        """Count the program of a tick."""
        self.ticks[result.relaxed] += 1
        self.slack = max(self.slack, result.slack)

    def solved(
        self, solver: SolverSettings, horizon: Horizon, iterate: _engine.Iterate, most: int
    ) -> tuple[_engine.Iterate, bool]:
        """The iterate of a plan after at most ``most`` steps, and whether it is lost; counts both."""
        begun = clocks.perf_counter()
        iterate, reports = solver.solve(horizon, iterate, most)
        self.solving.append(clocks.perf_counter() - begun)
        self.steps.append(len(reports))
        self.primal.append(reports[-1]["after"])
        lost = is_lost(iterate, reports)
        self.anew += lost
        for name, violation in horizon.violations(iterate["x"]).items():
            self.relaxed[name] = self.relaxed.get(name, 0) + (violation > VIOLATED)
            self.violations[name] = max(self.violations.get(name, 0.0), violation)
        return iterate, lost


VIOLATED = 1e-2  # scaled violation above which a row counts as relaxed
# Makes the plan that is valid from a given time on, s.
Make = Callable[[float], HorizonMotion]


class Plans:
    """The plan in use and the next one.

    A plan takes effect ``delay`` s after its initial state was measured. In lockstep the simulation waits for
    it; if ``live``, a thread computes it, and the last plan stays in use until it is ready.

    Args:
        period: time between plans, s.
        delay: time from measurement to effect, s.
        live: whether a thread makes the plans.
    """

    def __init__(self, period: float, delay: float, *, live: bool = False) -> None:
        self.period, self.delay = period, delay
        self.motion: HorizonMotion | None = None
        self.report = ControllerReport()
        self._pending: HorizonMotion | Future[HorizonMotion] | None = None
        self._begin, self._next, self._late = 0.0, -math.inf, False
        self._thread = ThreadPoolExecutor(1, "plans") if live else None

    def fresh(self) -> Plans:
        """Plans with the same times, none of which is made yet."""
        return Plans(self.period, self.delay, live=self._thread is not None)

    def update(self, time: float, maker: Callable[[], Make]) -> HorizonMotion:
        """The plan for the tick at ``time`` s; ``maker`` is called when a new plan is due."""
        pending = self._pending
        if pending is not None and time >= self._begin - 1e-9:
            ready = not isinstance(pending, Future) or pending.done()
            if ready:
                self.motion = pending.result() if isinstance(pending, Future) else pending
                self._pending, self._late = None, False
            elif not self._late:
                self.report.missed, self._late = self.report.missed + 1, True
        if self.motion is None:
            self.motion = self._timed(maker(), time)
            self._next = time + self.period
        elif time >= self._next - 1e-9 and self._pending is None:
            self._begin = time + self.delay
            self._next = time + self.period
            if self._thread is None:
                self._pending = self._timed(maker(), self._begin)
            else:
                self._pending = self._thread.submit(self._timed, maker(), self._begin)
        return self.motion

    def _timed(self, make: Make, begin: float) -> HorizonMotion:
        started = clocks.perf_counter()
        motion = make(begin)
        seconds = clocks.perf_counter() - started
        self.report.planning.append(seconds)
        if self._thread is None and self.motion is not None:
            self.report.missed += seconds > self.delay
        return motion

    def close(self) -> None:
        """Wait for the thread and end it."""
        if self._thread is not None:
            self._thread.shutdown(wait=True, cancel_futures=True)
