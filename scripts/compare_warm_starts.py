"""Iterations and solver time of starts from other solutions against the problems' own guesses.

uv run python -m scripts.compare_warm_starts
uv run python -m scripts.compare_warm_starts --solver fatrop

Solutions at other parameters, on other grids and of other schemes as starts; ladders of grids; sequences over
a parameter. A time is the median of ``--repeat`` solves.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

import click

import problems
import trajopt
from trajopt.solution import Solution
from trajopt.solvers.drivers import SOLVERS

Values = Mapping[str, object]
Grid = tuple[str | None, int | None]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem solved at ``before`` on ``coarse``, which starts the solve at ``after`` on ``grid``."""

    problem: str
    before: Values = field(default_factory=dict)
    after: Values = field(default_factory=dict)
    coarse: Grid = (None, None)
    grid: Grid = (None, None)

    @property
    def title(self) -> str:
        """What changes, in words."""
        changes = ", ".join(f"{name} {value}" for name, value in self.after.items())
        grids = f"{_grid(self.coarse)} to {_grid(self.grid)}" if self.coarse != self.grid else ""
        return f"{self.problem}: {', '.join(part for part in (changes, grids) if part) or 'the same'}"


CASES = (
    Case(problem="solo12-jump"),
    Case(problem="solo12-jump", after={"distance": 0.33}),
    Case(problem="solo12-jump", after={"distance": 0.45}),
    Case(problem="solo12-jump", after={"flight": 0.36}),
    Case(problem="solo12-jump", after={"yaw": "40deg", "height": 0.1}),
    Case(problem="solo12-jump", coarse=(None, 25), grid=(None, 50)),
    Case(problem="solo12-jump", grid=("radau:3", 50)),
    Case(problem="ur5-reach", after={"x": 0.35}),
    Case(problem="ur5-reach", after={"duration": 0.8}),
    Case(problem="ur5-reach", coarse=("legendre:1", 10), grid=("legendre:3", 60)),
    Case(problem="hopper-hop", after={"distance": 0.22}),
    Case(problem="hopper-hop", coarse=(None, 20), grid=(None, 50)),
    Case(problem="biped-walk", after={"length": 0.21}),
    Case(problem="biped-walk", after={"length": 0.26}),
    Case(problem="solo12-slope", coarse=(None, 20), grid=(None, 30)),
    Case(problem="talos-wall", coarse=(None, 16), grid=(None, 24)),
)
LADDERS: tuple[tuple[str, tuple[Grid, ...]], ...] = (
    ("solo12-jump", (("legendre:1", 15), ("legendre:2", 50))),
    ("solo12-jump", (("legendre:2", 15), ("legendre:2", 50))),
    ("solo12-flip", (("legendre:2", 25), ("legendre:2", 50), ("legendre:2", 100))),
    ("biped-walk", (("legendre:1", 16), ("legendre:2", 32))),
    ("ur5-reach", (("legendre:1", 10), ("legendre:3", 60))),
)
SEQUENCES = (
    ("solo12-jump", "distance", (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)),
    ("ur5-reach", "x", (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)),
    ("biped-walk", "length", (0.16, 0.18, 0.2, 0.22, 0.24)),
)


def _grid(grid: Grid) -> str:
    scheme, intervals = grid
    return f"{scheme or 'default'}@{intervals or 'default'}"


def _cost(solutions: list[Solution], repeats: list[float]) -> str:
    iterations = sum(solution.meta["iterations"] for solution in solutions)
    failed = "" if all(solution.success for solution in solutions) else " not solved"
    return f"{iterations:4d} {statistics.median(repeats):6.2f} s{failed}"


def _seconds(solutions: list[Solution]) -> float:
    return sum(solution.meta["wall_time_s"] for solution in solutions)


def run_case(case: Case, solver: str, repeat: int) -> None:
    """One line: cold, warm, and how the objectives differ."""
    before = problems.load(case.problem, **case.before)
    after = problems.load(case.problem, **case.after)
    scheme, intervals = case.coarse
    first = trajopt.solve(before, transcription=scheme, intervals=intervals, solver=solver)
    scheme, intervals = case.grid
    grid = {"transcription": scheme, "intervals": intervals, "solver": solver}
    cold = [trajopt.solve(after, **grid) for _ in range(repeat)]
    warm = [trajopt.solve(after, start=first, **grid) for _ in range(repeat)]
    lines = [_cost(runs[:1], [_seconds([one]) for one in runs]) for runs in (cold, warm)]
    differ = warm[0].meta["objective"] / cold[0].meta["objective"] - 1
    click.echo(f"{case.title:60s} cold {lines[0]}  warm {lines[1]}  objective {differ:+.1e}")


def run_ladder(name: str, rungs: tuple[Grid, ...], solver: str, repeat: int) -> None:
    """One line: the finest grid from the own guess, and all rungs together."""
    found = [
        trajopt.solve_ladder(problems.load(name), rungs, compare=True, solver=solver) for _ in range(repeat)
    ]
    cold = [ladder.cold for ladder in found if ladder.cold is not None]
    title = f"{name}: {' '.join(_grid(rung) for rung in rungs)}"
    total = _cost(list(found[0].rungs), [_seconds(list(ladder.rungs)) for ladder in found])
    each = " + ".join(str(rung.meta["iterations"]) for rung in found[0].rungs)
    click.echo(f"{title:60s} cold {_cost(cold[:1], [_seconds([one]) for one in cold])}  all {total} ({each})")


def run_sequence(name: str, parameter: str, values: tuple[float, ...], solver: str) -> None:
    """One line: all values from own guesses, and each from the last."""
    found = trajopt.continuation(
        lambda value: problems.load(name, **{parameter: value}), values, compare=True, solver=solver
    )
    steps = [step.solution for step in found.steps]
    cold = [step.cold for step in found.steps if step.cold is not None]
    title = f"{name}: {parameter} {values[0]:g} to {values[-1]:g}, {len(values)} values"
    each = " ".join(str(one.meta["iterations"]) for one in steps)
    costs = [_cost(runs, [_seconds(runs)]) for runs in (cold, steps)]
    compiled = sum(one.meta["functions_compiled"] for one in steps[1:])
    click.echo(f"{title:60s} cold {costs[0]}  warm {costs[1]} ({each}); compiled after the first: {compiled}")


@click.command()
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--repeat", default=3, help="solves of which the median time is taken")
def main(solver: str, repeat: int) -> None:
    """Print a line for every case, ladder and sequence."""
    for case in CASES:
        run_case(case, solver, repeat)
    for name, rungs in LADDERS:
        run_ladder(name, rungs, solver, repeat)
    for name, parameter, values in SEQUENCES:
        run_sequence(name, parameter, values, solver)


if __name__ == "__main__":
    main()
