"""Sequential quadratic programming with a filter line search, for few and cheap steps from a good guess.

Each step solves a quadratic program of the problem's stages (see `qp`) with the NLP's own Hessian: the
exact one of the Lagrangian, or Gauss-Newton's. A filter decides how far to go (see `sqp_filter`), after a
second-order correction where the full step increases the violation. Where the program has no feasible
point, or no step along its direction is taken, the step comes from an elastic program, which may violate rows
at a price, and must reduce their violation; where that is impossible the problem is locally infeasible
(Nocedal and Wright, "Numerical Optimization", 2006, chapter 18; Fletcher and Leyffer, "Nonlinear programming
without a penalty function", Mathematical Programming 91, 2002).

``delta`` is added to the diagonal where the curvature is wrong: after a program that is not solved, a
direction along which the objective rises, or a short step.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from trajopt.solvers.convexification import ConvexificationShare, ConvexifiedHessian
from trajopt.solvers.qp import QpStep, QuadraticProgram, StageQp
from trajopt.solvers.result import Callback
from trajopt.solvers.sqp_filter import Filter
from trajopt.solvers.sqp_point import Evaluator, KktErrors, SqpIterate
from trajopt.solvers.sqp_settings import SqpSettings
from trajopt.transcription.nlp import Nlp

# Added to the diagonal: the least, the factor by which it grows, the most after short steps, and the most
# for a program that is not solved.
FIRST_DELTA, DELTA_GROWTH, SHORT_STEP_DELTA, MOST_DELTA = 1e-4, 4.0, 1.0, 1e4
UNSOLVED_DELTA = 1e-2
# Added to the diagonal where negative curvature is removed.
CONVEX_DELTA = 1e-4
# Steps shorter than this share of their direction increase delta; the shortest that are tried.
SHORT, SHORTEST, SHORTEST_ELASTIC = 0.2, 1e-3, 1e-6
# The elastic program: its first and least share of the objective, the fraction of the violation that may
# remain for the share to be accepted, and its curvature, in scaled units.
FIRST_SHARE, LEAST_SHARE, ACCEPTED, ELASTIC_DELTA = 0.1, 1e-4, 0.9, 1e-2
# With a smaller relative reduction of the violation, the point is a stationary point of the violation.
STATIONARY = 1e-6
# Larger multipliers only mean that rows contradict each other: they are set to zero for the Hessian.
LARGEST_MULTIPLIER = 1e6
# Accuracy of programs: this fraction of the present errors, the least accuracy, and the finest as a fraction
# of the tolerance.
QP_SHARE, LEAST_QP_ACCURACY, FINEST_QP = 1e-3, 1e-4, 1e-2
# A direction this short is at the level of rounding: values along it carry no information.
TINY = 1e-9


@dataclass(frozen=True, kw_only=True)
class SqpOutcome:
    """The last iterate and why it is the last; ``programs``: how many were solved, ``program_time`` in s."""

    point: SqpIterate
    errors: KktErrors
    status: str
    iterations: int
    programs: int
    program_iterations: int
    program_time: float


class _Stopped(Exception):  # noqa: N818 - it is not an error
    """The reason why no further step is taken."""


@dataclass
class Sqp:
    """One solve: ``run`` takes steps until a reason to stop."""

    nlp: Nlp
    settings: SqpSettings
    callback: Callback
    delta: float = field(init=False)
    iteration: int = field(default=0, init=False)
    last: Mapping[str, float] = field(default_factory=dict, init=False)
    programs: int = field(default=0, init=False)
    program_iterations: int = field(default=0, init=False)
    program_time: float = field(default=0.0, init=False)
    correcting: bool = field(default=True, init=False)
    convexity: ConvexificationShare = field(default_factory=ConvexificationShare, init=False)

    def __post_init__(self) -> None:
        self.evaluator = Evaluator(self.nlp)
        self.qp = StageQp(self.nlp)
        self.delta = self.settings.regularization

    def run(self, x: np.ndarray, lam_g: np.ndarray, lam_x: np.ndarray) -> SqpOutcome:
        """Solve from ``x``, projected onto its bounds, and multipliers of rows and bounds."""
        self.deadline = time.perf_counter() + self.settings.max_time
        self.point = self.evaluator.at(x, lam_g, lam_x)
        self.filter = Filter(self.point.pair.theta, 1e-3 * self.settings.feasibility)
        status = "Interrupted"
        try:
            while True:
                self._report_and_test()
                self.point = self._next()
                self.iteration += 1
        except _Stopped as reason:
            status = str(reason)
        except KeyboardInterrupt:
            pass
        return SqpOutcome(
            point=self.point,
            errors=self.evaluator.errors(self.point),
            status=status,
            iterations=self.iteration,
            programs=self.programs,
            program_iterations=self.program_iterations,
            program_time=self.program_time,
        )

    def _report_and_test(self) -> None:
        """Report the iterate; stop there if it has converged, or the time is up."""
        point, settings = self.point, self.settings
        errors = self.errors = self.evaluator.errors(point)
        seen = {
            "iteration": self.iteration,
            "objective": point.pair.f,
            "primal": errors.primal,
            "dual": errors.dual,
            "barrier": 0.0,
            "step": 0.0,
            "regularization": self.delta,
            "line_search": 0,
            "restoration": False,
        }
        if not self.callback({**seen, **self.last}, lambda: point.x.copy()):
            raise _Stopped("Interrupted")
        if not point.is_finite:
            raise _Stopped("NotFinite")
        if errors.primal <= settings.feasibility and errors.optimality <= settings.tolerance:
            raise _Stopped("Solved")
        if settings.early is not None and self.iteration > 0 and errors.primal <= settings.early:
            raise _Stopped("Early")
        if self.iteration >= settings.max_iterations:
            raise _Stopped("IterationLimit")
        self._watch_time()

    def _watch_time(self) -> None:
        if time.perf_counter() > self.deadline:
            raise _Stopped("TimeLimit")

    def _next(self) -> SqpIterate:
        """The point after one step: along the program's direction, or the elastic program's."""
        q = self.evaluator.program(self.point, self.point.lam_g)
        if not np.isfinite(q.hessian).all():
            raise _Stopped("NotFinite")
        for _ in range(3):
            step = self._direction(q)
            if step is None:
                break
            after = self._line_search(q, step)
            if after is not None:
                return after
            if not self._more_curvature(FIRST_DELTA, SHORT_STEP_DELTA):
                break
        return self._elastic_step()

    def _direction(self, q: QuadraticProgram) -> QpStep | None:
        """The program's solution: with the Hessian as it is, or without its negative curvature.

        None where rows contradict each other, or no program can be solved.
        """
        for _ in self.convexity.shares():
            step = self._program(q)
            if step.infeasible or self._is_descent(q, step):
                self.convexity.was_enough()
                return None if step.infeasible else step
            self._watch_time()
        return None

    def _is_descent(self, q: QuadraticProgram, step: QpStep) -> bool:
        """Whether the program was solved, and the step descends where the rows hold."""
        holds = self.point.pair.theta <= self.filter.negligible
        uphill = holds and float(q.gradient @ step.d) >= 0 and np.abs(step.d).max() > TINY
        return step.solved and not uphill

    def _program(self, q: QuadraticProgram) -> QpStep:
        """Solve a program without the present share of its Hessian's negative curvature."""
        if self.convexity.share == 0:
            return self._timed(partial(self.qp.solve, q, self.delta, self._accuracy()))
        known, qp = self._convex
        convex = replace(q, hessian=known.values(q.hessian, self.convexity.share))
        return self._timed(partial(qp.solve, convex, max(self.delta, CONVEX_DELTA), self._accuracy()))

    @cached_property
    def _convex(self) -> tuple[ConvexifiedHessian, StageQp]:
        known = ConvexifiedHessian(self.nlp)
        return known, StageQp(self.nlp, (known.row, known.column))

    def _more_curvature(self, least: float, most: float) -> bool:
        """Raise delta, up to ``most``; False where it was there already."""
        before = self.delta
        self.delta = max(before, min(most, max(least, 2 * DELTA_GROWTH * before)))
        return self.delta > before

    def _line_search(self, q: QuadraticProgram, step: QpStep) -> SqpIterate | None:
        """The first point along a direction that the filter accepts, or None."""
        here, slope = self.point.pair, float(q.gradient @ step.d)
        share, trials = 1.0, 0
        while share >= SHORTEST:
            x = self.evaluator.inside(self.point.x + share * step.d)
            there, trials = self.evaluator.pair(x), trials + 1
            if self.filter.takes(here, there, slope, share) or np.abs(step.d).max() <= TINY:
                return self._taken(x, step, slope, share, trials)
            if trials == 1 and self.correcting and here.theta <= there.theta < np.inf:
                corrected = self._corrected(q, step, slope)
                if corrected is not None:
                    return corrected
            share *= 0.5
            self._watch_time()
        return None

    def _corrected(self, q: QuadraticProgram, step: QpStep, slope: float) -> SqpIterate | None:
        """The point after a second-order correction, if the filter accepts it.

        Rows have their values at the end of the first direction. After a rejected correction none is tried
        until a full step is accepted: far from a solution they seldom help.
        """
        step_found = self._program(self.evaluator.corrected_program(self.point, q, step.d))
        x = self.evaluator.inside(self.point.x + step_found.d)
        if step_found.solved and self.filter.takes(self.point.pair, self.evaluator.pair(x), slope, 1.0):
            return self._taken(x, step_found, slope, 1.0, 2)
        self.correcting = False
        return None

    def _taken(self, x: np.ndarray, step: QpStep, slope: float, share: float, trials: int) -> SqpIterate:
        """Go to ``x``; update the filter, the multipliers and delta."""
        point, here = self.point, self.point.pair
        if not self.filter.about_objective(here, slope, share):
            self.filter.keep(here)
        self.last = {"step": share, "line_search": trials, "regularization": self.delta, "restoration": False}
        if share < SHORT:
            self._more_curvature(FIRST_DELTA, SHORT_STEP_DELTA)
        elif share == 1.0:
            self.correcting = True
            self.delta = self.delta / DELTA_GROWTH if self.delta > FIRST_DELTA / DELTA_GROWTH else 0.0
        lam_g = point.lam_g + share * (step.lam_g - point.lam_g)
        lam_x = point.lam_x + share * (step.lam_x - point.lam_x)
        if np.abs(lam_g).max(initial=0.0) > LARGEST_MULTIPLIER:
            lam_g, lam_x = np.zeros_like(lam_g), np.zeros_like(lam_x)
        return self.evaluator.at(x, lam_g, lam_x)

    def _elastic_step(self) -> SqpIterate:
        """A step that reduces the violation of the rows; stops where there is none."""
        here = self.point.pair
        if here.theta <= self.filter.negligible:
            raise _Stopped("NoStep")
        step = self._elastic_direction()
        if here.theta - step.missed <= STATIONARY * here.theta:
            raise _Stopped("Infeasible")
        self.filter.keep(here)
        share, trials = 1.0, 1
        while share >= SHORTEST_ELASTIC:
            x = self.evaluator.inside(self.point.x + share * step.d)
            theta = self.evaluator.pair(x).theta
            if theta <= here.theta - 1e-4 * share * (here.theta - step.missed):
                self.last = {"step": share, "line_search": trials, "restoration": True}
                self.delta = min(self.delta, UNSOLVED_DELTA)
                zero_g, zero_x = np.zeros_like(self.point.lam_g), np.zeros_like(self.point.lam_x)
                return self.evaluator.at(x, zero_g, zero_x)
            share, trials = 0.5 * share, trials + 1
        raise _Stopped("NoStep")

    def _elastic_direction(self) -> QpStep:
        """The elastic program with curvature of the objective alone, which rows cannot make indefinite."""
        here, delta, share = self.point.pair, ELASTIC_DELTA, FIRST_SHARE
        q = self.evaluator.program(self.point, np.zeros_like(self.point.lam_g))
        best: QpStep | None = None
        while share >= LEAST_SHARE and delta <= MOST_DELTA:
            self._watch_time()
            step = self._timed(partial(self.qp.elastic, q, delta, share, self._finest))
            if not step.solved:
                delta *= 10
                continue
            best = step
            if step.missed <= ACCEPTED * here.theta:
                break
            share /= 10
        if best is None:
            raise _Stopped("NoStep")
        return best

    def _accuracy(self) -> float:
        worst = max(self.errors.primal, self.errors.optimality)
        return max(self._finest, min(LEAST_QP_ACCURACY, QP_SHARE * worst))

    @property
    def _finest(self) -> float:
        return FINEST_QP * self.settings.tolerance

    def _timed(self, solve: Callable[[], QpStep]) -> QpStep:
        begun = time.perf_counter()
        step = solve()
        self.program_time += time.perf_counter() - begun
        self.programs += 1
        self.program_iterations += step.iterations
        return step
