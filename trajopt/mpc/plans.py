"""When plans are made and used, and the steps of the solver that make them; shared by legs and arms."""

from __future__ import annotations

import math
import time as clocks
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from trajopt import _engine
from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.mpc.horizon import Horizon
from trajopt.mpc.motion import HorizonMotion

# Multipliers or variables above this, over their units, count as a start that was lost: the next plan begins
# anew.
LOST = 1e6
# Rows that are missed by more than this of their units after the last step: a plan that is not used.
UNUSABLE = 1.0
# A fresh start is this far inside its bounds, over their units, and takes this many times the steps.
PUSH, FRESH = 1e-2, 4


@checked
@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """Steps of the interior point at a tick.

    Args:
        steps: at least.
        most_steps: where residuals stay above ``tolerance``.
        changed_steps: at most, where the pattern of contacts is another than that of the last tick.
        tolerance: of rows and optimality, over their units, with which a tick ends.
        barrier: the least.
        most_barrier: to which short steps raise it.
        seconds: no step begins after so many; 0 is no limit.
    """

    steps: PositiveCount = 2
    most_steps: PositiveCount = 4
    changed_steps: PositiveCount = 6
    tolerance: Positive = 1e-2
    barrier: Positive = 1e-4
    most_barrier: Positive = 1e-2
    seconds: float = 0.0

    def fresh(self, horizon: Horizon, x: np.ndarray) -> _engine.Iterate:
        """An iterate from scaled variables alone."""
        zero = np.zeros(len(horizon.compliance))
        return horizon.solver.complete(x, zero, *horizon.bounds, self.barrier, PUSH)

    def solve(
        self, horizon: Horizon, iterate: _engine.Iterate, most: int
    ) -> tuple[_engine.Iterate, list[_engine.StepReport]]:
        """The iterate after at most so many steps, from the start that the horizon fixes."""
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
    """Whether a plan is not to be used, and the next one begins anew."""
    worst = max(float(np.abs(iterate["y"]).max()), float(np.abs(iterate["x"]).max()))
    kept = math.isfinite(worst) and worst < LOST and reports[-1]["after"] < UNUSABLE
    return not (kept and reports[-1]["primal_step"] > 0)


@dataclass
class ControllerReport:
    """Of all ticks: seconds of plans, of their solver alone and of torques; what happened to plans.

    steps: of the solver. primal: residuals of the rows of plans. missed: plans that were
    not ready in time. anew: plans that lost their start. relaxed: plans whose rows are violated by more than
    `RELAXED` of their units, by the name of the rows; violations: the largest.
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

    def solved(
        self, solver: SolverSettings, horizon: Horizon, iterate: _engine.Iterate, most: int
    ) -> tuple[_engine.Iterate, bool]:
        """The iterate of a plan after at most so many steps, counted, and whether it is lost."""
        begun = clocks.perf_counter()
        iterate, reports = solver.solve(horizon, iterate, most)
        self.solving.append(clocks.perf_counter() - begun)
        self.steps.append(len(reports))
        self.primal.append(reports[-1]["after"])
        lost = is_lost(iterate, reports)
        self.anew += lost
        for name, violation in horizon.violations(iterate["x"]).items():
            self.relaxed[name] = self.relaxed.get(name, 0) + (violation > RELAXED)
            self.violations[name] = max(self.violations.get(name, 0.0), violation)
        return iterate, lost


# Violations of this part of a row's unit count as relaxed.
RELAXED = 1e-2

# A plan from the time on that it is given.
Make = Callable[[float], HorizonMotion]


class Plans:
    """The plan in use, and the next one.

    A plan begins ``delay`` s after the state that it is made from was measured, and is used from then on. In
    lockstep it is made at once, and the simulation waits; ``live``, a thread makes it, and the last plan
    goes on until it is ready.

    Args:
        period: between begins of plans, s.
        delay: s.
        live: made by a thread.
    """

    def __init__(self, period: float, delay: float, *, live: bool = False) -> None:
        self.period, self.delay = period, delay
        self.motion: HorizonMotion | None = None
        self.report = ControllerReport()
        self._pending: HorizonMotion | Future[HorizonMotion] | None = None
        self._begin, self._next, self._late = 0.0, -math.inf, False
        self._thread = ThreadPoolExecutor(1, "plans") if live else None

    def update(self, time: float, maker: Callable[[], Make]) -> HorizonMotion:
        """The plan for a tick at ``time`` s; where one begins, ``maker`` is asked for what makes it."""
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
        """Wait for the thread, and end it."""
        if self._thread is not None:
            self._thread.shutdown(wait=True, cancel_futures=True)
