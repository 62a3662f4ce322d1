"""Iterations and CPU time of starts from other solutions against the problems' own guesses.

uv run python -m scripts.compare_warm_starts
uv run python -m scripts.compare_warm_starts --solver fatrop

Solutions at other parameters, on other grids and of other schemes as starts; ladders of grids; sequences over
a parameter. A time is the solver's, of the processor, from the first iterate to the last: the median of
``--repeat`` solves. What a step costs besides (transcription, check) is the same for both.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import click

from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.solving import prepare, solve_prepared
from trajopt_library import problems

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
# From a guess that stands still instead of the problem's own.
STILL: tuple[tuple[str, tuple[Grid, ...]], ...] = (
    ("solo12-jump", (("legendre:2", 15), ("legendre:2", 50))),
    ("solo12-flip", (("legendre:2", 25), ("legendre:2", 50))),
    ("biped-walk", (("legendre:2", 14), ("legendre:2", 32))),
)
PARTS = ("cases", "ladders", "still", "sequences")
SEQUENCES = (
    ("solo12-jump", "distance", (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)),
    ("ur5-reach", "x", (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)),
    ("biped-walk", "length", (0.16, 0.18, 0.2, 0.22, 0.24)),
)


def _grid(grid: Grid) -> str:
    scheme, intervals = grid
    return f"{scheme or 'default'}@{intervals or 'default'}"


@dataclass(frozen=True)
class Stop:
    """A problem's values and grid; ``still`` takes the guess that does not move."""

    name: str
    values: Values
    grid: Grid
    still: bool = False

    def problem(self) -> Problem:
        """The problem, with its guess."""
        own = problems.load(self.name, **self.values)
        return replace(own, guess=lambda t: own.robot.reference) if self.still else own


@dataclass(frozen=True)
class Run:
    """A solution, the solver's CPU time in s, and how many functions were compiled for it."""

    solution: Solution
    seconds: float
    compiled: int

    @property
    def iterations(self) -> int:
        """Of the solver."""
        return int(self.solution.meta["iterations"])


def solved(stop: Stop, solver: str, start: Run | None = None, repeat: int = 1) -> Run:
    """Solve, as often as asked; the median time."""
    before = None if start is None else start.solution
    scheme, intervals = stop.grid
    prepared = prepare(stop.problem(), transcription=scheme, intervals=intervals, start=before)
    seconds, origin = [], {"seed": 0, "perturb": 0.0}
    for _ in range(repeat):
        stamps: list[float] = []
        solution = solve_prepared(
            prepared,
            prepared.guess,
            origin=origin,
            solver=solver,
            progress=lambda _, stamps=stamps: stamps.append(time.process_time()) is None,
        )
        seconds.append(stamps[-1] - stamps[0])
    return Run(solution, statistics.median(seconds), prepared.compilation.built)


def _cost(runs: Sequence[Run]) -> str:
    failed = "" if all(run.solution.success for run in runs) else " not solved"
    return f"{sum(run.iterations for run in runs):4d} {sum(run.seconds for run in runs):6.2f} s{failed}"


def _each(runs: Sequence[Run]) -> str:
    return " ".join(str(run.iterations) for run in runs)


def run_case(case: Case, solver: str, repeat: int) -> None:
    """One line: cold, warm, and how the objectives differ."""
    first = solved(Stop(case.problem, case.before, case.coarse), solver)
    after = Stop(case.problem, case.after, case.grid)
    cold, warm = (solved(after, solver, start, repeat) for start in (None, first))
    differ = warm.solution.meta["objective"] / cold.solution.meta["objective"] - 1
    click.echo(f"{case.title:60s} cold {_cost([cold])}  warm {_cost([warm])}  objective {differ:+.1e}")


def run_chain(title: str, stops: Sequence[Stop], solver: str, repeat: int) -> None:
    """One line: the stops from own guesses, and each from the last; of a ladder the last counts."""
    ladder = len({stop.grid for stop in stops}) > 1
    cold = [solved(stop, solver, repeat=repeat) for stop in (stops[-1:] if ladder else stops)]
    warm: list[Run] = []
    for stop in stops:
        warm.append(solved(stop, solver, warm[-1] if warm else None, repeat))
    again = sum(run.compiled for run in warm[1:])
    name = f"{stops[0].name}: {title}"
    click.echo(f"{name:60s} cold {_cost(cold)}  all {_cost(warm)} ({_each(warm)}), {again} compiled")


def run_ladders(
    ladders: Sequence[tuple[str, tuple[Grid, ...]]], still: bool, solver: str, repeat: int
) -> None:
    """A line for each ladder."""
    for name, rungs in ladders:
        title = " ".join(map(_grid, rungs)) + (", standing still" if still else "")
        run_chain(title, [Stop(name, {}, rung, still) for rung in rungs], solver, repeat)


@click.command()
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
@click.option("--repeat", default=3, help="solves of which the median time is taken")
@click.option("--part", "parts", multiple=True, type=click.Choice(PARTS), help="default: all")
def main(solver: str, repeat: int, parts: tuple[str, ...]) -> None:
    """Print a line for every case, ladder and sequence."""
    wanted = parts or PARTS
    for case in CASES if "cases" in wanted else ():
        run_case(case, solver, repeat)
    for part, ladders in (("ladders", LADDERS), ("still", STILL)):
        run_ladders(ladders if part in wanted else (), part == "still", solver, repeat)
    for name, parameter, values in SEQUENCES if "sequences" in wanted else ():
        title = f"{parameter} {values[0]:g} to {values[-1]:g}, {len(values)} values"
        stops = [Stop(name, {parameter: value}, (None, None)) for value in values]
        run_chain(title, stops, solver, repeat)


if __name__ == "__main__":
    main()
