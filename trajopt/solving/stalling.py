"""Handle a solve that stalls: certify it as infeasible, or restart it from a feasible point.

While IPOPT runs, its figures are tested for progress. If it stalls, the elastic problem is solved from the
iterate, within the same limits. A minimum with a clear violation ends the solve as infeasible. From a point
where all rows hold, the solve starts again. Otherwise the solve continues, and is tested again after twice as
many iterations. So the test alone never ends a solve that would succeed.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from trajopt.solvers.drivers import check_solver, run_solver
from trajopt.solvers.elastic import ElasticPoint, counted_from, least_violation
from trajopt.solvers.result import Callback, Option, Result, StoppingCriteria, WarmMultipliers
from trajopt.solvers.status import Status
from trajopt.transcription.nlp import Nlp

# Rows violated by less than this, scaled units, count as feasible.
VIOLATION = 1e-3
# A solve is tested after more than START iterations; the last ones, TAIL, must all have large multipliers.
START, TAIL = 8, 3
# Dual infeasibility of multipliers that grow without bound, as where rows contradict each other. Measured on
# first meshes with IPOPT: 64 of 65 successful solves stay below 3e3 while rows are violated, and one below
# 1e5; ten that cannot succeed exceed 1e4 within 4 to 21 iterations, and 1e6 within 34.
DUAL_LIMIT = 1e4
# The violation, or the dual infeasibility, must fall by this factor within this many iterations.
DECREASE, WINDOW = 0.5, 20
CERTIFIED = "Certified_Infeasible"
# IPOPT's status if iterations of elastic problems have reached the limit.
LIMITED = "Maximum_Iterations_Exceeded"
# Statuses of IPOPT that do not settle feasibility: its restoration fails, or no step makes progress.
UNSETTLED = Status.INFEASIBLE, Status.STEP_FAILED
# Figures for the elastic problem that is solved afterwards.
NO_FIGURES = {"barrier": 0.0, "step": 0.0, "regularization": 0.0, "line_search": 0}
# Number of last iterations whose median decides whether a solve ends feasible: single ones may violate rows.
MEDIAN_COUNT = 20
# Iteration limit of one search for the least violation: successful ones take 20 to 200.
MOST_ELASTIC = 250


def is_stalled(primal: Sequence[float], dual: Sequence[float]) -> bool:
    """Return whether a solve seems to stall, from its primal and dual infeasibility at each iteration.

    Pass an infinite dual infeasibility for iterations of the restoration phase, which have none.
    """
    if len(primal) <= START or min(primal) <= VIOLATION:
        return False
    creeps = min(dual[-TAIL:]) > DUAL_LIMIT
    return creeps or (_stays(primal) and _stays(dual))


def _stays(figures: Sequence[float]) -> bool:
    """Return whether the last figures are hardly below the best one before them."""
    return len(figures) > WINDOW and min(figures[-WINDOW:]) > DECREASE * min(figures[:-WINDOW])


class StallTest:
    """Solver callback that forwards to another one, and tests feasibility if the solve stalls.

    Attributes:
        verdict: The elastic point that ended the solve; None if there is none.
        spent: Iterations of elastic problems, which count against the limit.
        limited: Whether these have used up the limit.
    """

    def __init__(self, nlp: Nlp, callback: Callback, stop: StoppingCriteria) -> None:
        self.nlp, self.callback, self.stop = nlp, callback, stop
        self.deadline = time.perf_counter() + stop.max_time
        self.primal: list[float] = []
        self.dual: list[float] = []
        self.next, self.spent, self.function_time = 0, 0, 0.0
        self.limited = False
        self.verdict: ElasticPoint | None = None

    def __call__(self, figures: dict[str, float], unknowns: Callable[[], np.ndarray]) -> bool:
        """Handle one iteration; return False if the callback stops it, or a verdict is found."""
        reported = {**figures, "iteration": figures["iteration"] + self.spent}
        if not self.callback(reported, unknowns):
            return False
        self.primal.append(figures["primal"])
        self.dual.append(np.inf if figures["restoration"] else figures["dual"])
        self.limited = self.spent > 0 and reported["iteration"] >= self.stop.max_iterations
        if self.limited:
            return False
        if len(self.primal) < self.next or not is_stalled(self.primal, self.dual):
            return True
        self.next = 2 * len(self.primal)
        x = np.array(unknowns())
        return len(x) == 0 or self.look(reported, x)

    def look(self, figures: dict[str, float], x: np.ndarray) -> bool:
        """Search for a verdict from variables ``x``; return False if found, or if the callback stops it."""
        left = int(self.stop.max_iterations - figures["iteration"])
        seconds = self.deadline - time.perf_counter()
        if left <= 0 or seconds <= 0:  # the solver stops by itself
            return True

        def tell(elastic: dict[str, float], read: Callable[[], np.ndarray]) -> bool:
            return self.callback({**figures, "iteration": elastic["iteration"], "restoration": True}, read)

        point = least_violation(
            self.nlp,
            x,
            counted_from(int(figures["iteration"]), tell),
            max_iterations=min(left, MOST_ELASTIC),
            max_time=seconds,
        )
        self.spent += point.iterations
        self.function_time += point.function_time
        if point.feasible or point.infeasible:
            self.verdict = point
        return self.verdict is None and not point.stopped


def solve_or_certify(
    nlp: Nlp,
    start: np.ndarray,
    solver: str,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None = None,
) -> tuple[Result, ElasticPoint | None]:
    """Call `run_solver` with the progress test if the solver supports it; also return any certificate."""
    if nlp.hessian not in check_solver(solver, nlp.hessian).certifies_with:
        return run_solver(nlp, start, solver, stop, options, callback, warm), None
    begun = time.perf_counter()
    test = StallTest(nlp, callback, stop)
    result = run_solver(nlp, start, solver, stop, options, test, warm)
    if result.status in UNSETTLED and test.verdict is None and not result.primal <= VIOLATION:
        known = {"iteration": result.iterations + test.spent, "objective": result.objective}
        test.look({**NO_FIGURES, **known, "primal": result.primal, "dual": result.dual}, result.x)
    result = replace(
        result,
        iterations=min(result.iterations + test.spent, stop.max_iterations),
        function_time=result.function_time + test.function_time,
        status=Status.ITERATION_LIMIT if test.limited else result.status,
        solver_status=LIMITED if test.limited else result.solver_status,
        recent_primal=float(np.median(test.primal[-MEDIAN_COUNT:])) if test.primal else np.inf,
    )
    if test.verdict is None:
        return result, None
    if test.verdict.infeasible:
        return _certified(nlp, result, test.verdict), test.verdict
    left = stop.left(result.iterations, time.perf_counter() - begun)
    onwards = counted_from(result.iterations, callback)
    again = run_solver(nlp, test.verdict.x, solver, left, options, onwards)
    return replace(
        again,
        iterations=result.iterations + again.iterations,
        wall_time=result.wall_time + again.wall_time,
        function_time=result.function_time + again.function_time,
    ), None


def _certified(nlp: Nlp, result: Result, point: ElasticPoint) -> Result:
    """Return the point of least violation, without multipliers: those are of the elastic problem."""
    return replace(
        result,
        x=point.x,
        lam_g=np.zeros_like(result.lam_g),
        lam_x=np.zeros_like(result.lam_x),
        status=Status.INFEASIBLE,
        solver_status=CERTIFIED,
        objective=float(nlp.engine.f(point.x)),
        primal=float(point.gives.max()),
        dual=float("nan"),
        complementarity=float("nan"),
    )
