"""Variables that a uniform mesh and a refined one need for the same error.

    uv run python -m scripts.compare_refinement solo12-jump --target 1e-3 --target 1e-4 --target 1e-5

The uniform mesh is the smallest of the problem's own scheme that reaches the target, found by bisection on
the number of intervals; the refined ones only split its intervals, or raise degrees too. Errors are measured
(`trajopt.refinement`): open loop by numeric Pinocchio, worst phase, or drift of contacts.
"""

from __future__ import annotations

from dataclasses import dataclass

import click

from trajopt import solve
from trajopt.certify.accuracy.measures import measure
from trajopt.cli.input import parse_settings
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.refine import Refinement, phase_errors, refine, tolerance_for
from trajopt_library import problems

# A uniform mesh of more intervals than this times the problem's own is not tried.
MOST = 16


@dataclass(frozen=True)
class Uniform:
    """A solution on a uniform mesh and its error, m."""

    solution: Solution
    error: float


class Uniforms:
    """Solutions of a problem on uniform meshes, each made once."""

    def __init__(self, problem: Problem, compile: str) -> None:
        self.problem, self.compile = problem, compile
        self.known: dict[tuple[int, float], Uniform] = {}

    def at(self, intervals: int, target: float) -> Uniform:
        """The one on that many intervals, with the solver's tolerance of that target."""
        tolerance = tolerance_for(target, self.problem.robot.length)
        if (intervals, tolerance) not in self.known:
            found = solve(self.problem, intervals=intervals, tolerance=tolerance, compile=self.compile)
            error = max(phase_errors(measure(found))) if found.success else float("inf")
            self.known[intervals, tolerance] = Uniform(found, error)
        return self.known[intervals, tolerance]

    def smallest(self, target: float) -> Uniform | None:
        """The one on fewest intervals with at most that error; None beyond `MOST`."""
        low, high = len(self.problem.schedule.phases) - 1, self.problem.default_intervals
        while self.at(high, target).error > target:
            low, high = high, 2 * high
            if high > MOST * self.problem.default_intervals:
                return None
        while high - low > max(1, high // 50):
            middle = (low + high) // 2
            low, high = (middle, high) if self.at(middle, target).error > target else (low, middle)
        return self.at(high, target)


def _uniform_line(found: Uniform | None) -> str:
    if found is None:
        return f"uniform: not within {MOST} times the problem's own intervals"
    meta = found.solution.meta
    return _line("uniform", found.solution, found.error, meta["iterations"], meta["wall_time_s"])


def _refined_line(name: str, found: Refinement, uniform: Uniform | None) -> str:
    iterations = sum(own.iterations for own in found.rounds)
    seconds = sum(own.wall_time for own in found.rounds)
    text = _line(name, found.solution, found.error, iterations, seconds)
    if not found.reached:
        return f"{text}  not reached: {found.why}"
    if uniform is None:
        return text
    return f"{text}  {found.solution.meta['variables'] / uniform.solution.meta['variables']:.0%} of uniform"


def _line(name: str, solution: Solution, error: float, iterations: int, seconds: float) -> str:
    grid = f"{solution.meta['transcription']} on {'+'.join(map(str, solution.meta['intervals']))}"
    return (
        f"{name:13s} {grid:48s} {solution.meta['variables']:6d} variables  {error:.1e} m "
        f"{iterations:4d} iterations {seconds:6.2f} s"
    )


@click.command()
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of the problem.")
@click.option("--target", "targets", type=float, multiple=True, default=(1e-3, 1e-4), help="Error in m.")
@click.option("--compile", default="quick", show_default=True, help="none, quick or fast.")
def main(problem: str, settings: tuple[str, ...], targets: tuple[float, ...], compile: str) -> None:
    """Print, for each target, what uniform and refined meshes need."""
    built = problems.load(problem, **parse_settings(settings, "--set"))
    uniforms = Uniforms(built, compile)
    for target in targets:
        click.echo(f"{problem}, error of at most {target:g} m")
        uniform = uniforms.smallest(target)
        click.echo(_uniform_line(uniform))
        for name, raise_degree in (("split", False), ("split, raised", True)):
            found = refine(built, target, raise_degree=raise_degree, compile=compile)
            click.echo(_refined_line(name, found, uniform))


if __name__ == "__main__":
    main()
