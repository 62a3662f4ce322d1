"""Tasks of a pair: a solve to the grade from its default guess or a perturbed start, and a simulation."""

import time
from typing import Any

from trajopt.errors import InputError
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.simulation.settings import Controller
from trajopt.solution.grid import mesh_of
from trajopt.solution.solution import Solution
from trajopt.solving.graded import solve
from trajopt.solving.ladder import total_effort
from trajopt.study.suite.cases import Case
from trajopt.study.suite.failure import failure_text, mode_of
from trajopt.study.suite.optima import described
from trajopt.study.suite.outcome import Attempt, Outcome
from trajopt.study.suite.physics import Physics, simulated
from trajopt.study.suite.settings import SuiteSettings


def solve_start(case: Case, settings: SuiteSettings, seed: int | None) -> tuple[Attempt, bytes | None, float]:
    """Solve a pair from a perturbed start, or from its default guess without a seed.

    Returns:
        The figures; the content of the solution file, None with a seed or for an iterate that is not a
            motion; and the time with building and checking, s.

    Raises:
        TrajoptError: if the pair cannot be built.
    """
    begin = time.perf_counter()
    problem = choose(families(), case.problem).load(case.values)
    noise: dict[str, Any] = {} if seed is None else {"seed": seed, "perturb": settings.sigma}
    solution = solve(
        problem,
        fixed_mesh=settings.fixed_mesh,
        solver=settings.solver,
        tolerance=settings.tolerance,
        max_iterations=settings.max_iterations,
        max_time=settings.max_time,
        **noise,
    )
    result = attempt(solution, seed, problem.robot.base != "fixed")
    content = _content(solution) if seed is None else None
    return result, content, time.perf_counter() - begin


def simulate_plan(plan: bytes, controller: Controller) -> tuple[Physics, bytes | None, float]:
    """Simulate a plan; returns the result, the file content of the simulated motion, and the time in s."""
    begin, solution = time.perf_counter(), Solution.from_bytes(plan)
    if not solution.converged:
        return Physics(), None, 0.0
    physics, motion = simulated(solution, controller)
    return physics, None if motion is None else _content(motion), time.perf_counter() - begin


def measure_case(case: Case, settings: SuiteSettings) -> Outcome:
    """Run one pair in this process. Raises TrajoptError if the pair cannot be built."""
    result, plan, seconds = solve_start(case, settings, None)
    physics = None
    if settings.simulate:
        physics = Physics()
        if plan is not None and result.legged:
            physics, _, spent = simulate_plan(plan, settings.controller)
            seconds += spent
    starts = [solve_start(case, settings, seed) for seed in settings.seeds]
    return Outcome(
        problem=case.problem,
        robot=case.robot,
        own=result,
        physics=physics,
        starts=tuple(start for start, _, _ in starts),
        total_time=seconds + sum(spent for _, _, spent in starts),
    )


def attempt(solution: Solution, seed: int | None, legged: bool) -> Attempt:
    """Figures of one solve to the grade; iterations and time are totals of all its meshes."""
    statistics = solution.statistics
    mode, mesh, spent = mode_of(statistics), mesh_of(solution), total_effort([solution])
    return Attempt(
        seed=seed,
        mode=mode,
        status=statistics.status,
        legged=legged,
        scheme=mesh.transcription,
        intervals=sum(mesh.counts),
        meshes=len(solution.statistics.rounds),
        variables=statistics.variables,
        constraints=statistics.constraints,
        iterations=spent["iterations"],
        wall_time=spent["wall_time_s"],
        objective=statistics.objective,
        primal=statistics.primal_infeasibility,
        dual=statistics.dual_infeasibility,
        complementarity=statistics.complementarity,
        detail=failure_text(statistics),
        figure=statistics.worst_figure,
        used=statistics.tolerance_used,
        motion="" if mode else described(solution),
    )


def _content(solution: Solution) -> bytes | None:
    try:
        return solution.to_bytes()
    except InputError:  # an iterate that is not finite
        return None
