"""Tasks of a pair: a solve to the grade from its default guess or a perturbed start, and a simulation."""

import math
import time
from dataclasses import dataclass
from typing import Any

from trajopt.errors import InputError, TrajoptError
from trajopt.motion.grid import mesh_of
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.simulation.settings import Controller
from trajopt.solving.ladder import total_effort
from trajopt.solving.solving import check_settings
from trajopt.study.solves import MOST_STARTS, SolveSettings, failure_text, file_content, mode_of
from trajopt.study.suite.cases import Case
from trajopt.study.suite.optima import described
from trajopt.study.suite.outcome import FELL, OFF, TRACKED, Attempt, Outcome, Physics

# Noise on the guess: a tenth of the natural units, that is of a leg's length or half a dozen degrees.
DEFAULT_SIGMA = 0.1
# Time limit of a solve, s: several times the library's longest solve on one core.
DEFAULT_MAX_TIME = 300.0


@dataclass(frozen=True, kw_only=True)
class SuiteSettings(SolveSettings):
    """How all pairs of a suite are solved. Raises `InputError` for invalid values.

    Args:
        max_time: for a solve with all its meshes, s.
        perturbed: number of perturbed starts, with seeds from 0.
        sigma: standard deviation of their noise, scaled units.
        simulate: also run solved plans of legged robots in MuJoCo.
        fixed_mesh: solve once, on the problem's mesh.
        controller: of the simulations.
    """

    max_time: float = DEFAULT_MAX_TIME
    perturbed: int = 0
    sigma: float = DEFAULT_SIGMA
    simulate: bool = False
    fixed_mesh: bool = False
    controller: Controller = "joints"

    def __post_init__(self) -> None:
        if not 0 <= self.perturbed <= MOST_STARTS:
            raise InputError(f"perturbed is {self.perturbed}", f"allowed: 0 to {MOST_STARTS}")
        if not (math.isfinite(self.sigma) and self.sigma > 0):
            raise InputError(f"sigma is {self.sigma:g}", "allowed: > 0")
        if self.controller != "joints" and not self.simulate:
            raise InputError("`controller` has no effect here", "allowed: with `simulate`")
        check_settings(self.solver, self.tolerance, self.max_iterations, self.max_time, self.sigma, 0)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the perturbed starts."""
        return tuple(range(self.perturbed))


def solve_start(case: Case, settings: SuiteSettings, seed: int | None) -> tuple[Attempt, bytes | None, float]:
    """Solve a pair from a perturbed start, or from its default guess without a seed.

    Returns:
        The figures; the content of the solution file, None with a seed or for an iterate that is not a
            motion; and the time with building and checking, s.

    Raises:
        TrajoptError: if the pair cannot be built.
    """
    begin = time.perf_counter()
    problem = choose(families(), case.family).load(case.values)
    noise: dict[str, Any] = {} if seed is None else {"seed": seed, "perturb": settings.sigma}
    solution = settings.solve(problem, fixed_mesh=settings.fixed_mesh, **noise)
    result = attempt(solution, seed, problem.robot.base != "fixed")
    content = file_content(solution) if seed is None else None
    return result, content, time.perf_counter() - begin


def simulate_plan(plan: bytes, controller: Controller) -> tuple[Physics, bytes | None, float]:
    """Simulate a plan; returns the result, the file content of the simulated motion, and the time in s."""
    from trajopt.simulation.simulate import simulate

    begin, solution = time.perf_counter(), Solution.from_bytes(plan)
    if not solution.converged:
        return Physics(), None, 0.0
    try:
        simulation = simulate(solution, controller=controller)
        content = file_content(simulation.as_solution())
    except (TrajoptError, ArithmeticError, ValueError) as error:
        reason = f"cannot be simulated: {' '.join(str(error).split())}"
        return Physics(detail=reason), None, time.perf_counter() - begin
    report = simulation.report
    physics = Physics(
        word=FELL if report.fell else TRACKED if report.passed else OFF,
        base_error_end=report.base_error_end,
        base_error_max=report.base_error_max,
        slips=report.slips,
        missed=report.missed,
        detail="; ".join(report.failures),
    )
    return physics, content, time.perf_counter() - begin


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
