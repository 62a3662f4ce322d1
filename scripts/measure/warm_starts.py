"""Starts from other solutions against the default guess: iterations and CPU time.

Ladders from the default guess and sequences over a parameter are `trajopt solve --ladder GRIDS --compare` and
`trajopt continue --vary ... --compare`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import click

from scripts.measure.guesses import standing_still
from scripts.measure.shared import Timed, head, median, row, solver_option, timed
from trajopt import solve, solve_ladder
from trajopt.solving.graded import solve as graded
from trajopt.solving.ladder import total_effort
from trajopt.solving.solving import prepare
from trajopt_library import problems

Grid = tuple[str | None, int | None]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem solved with its defaults on ``coarse``, which starts the solve at ``after`` on ``grid``."""

    problem: str
    after: Mapping[str, object] = field(default_factory=dict)
    coarse: Grid = (None, None)
    grid: Grid = (None, None)

    @property
    def title(self) -> str:
        """The changes, in words."""
        changes = [f"{name} {value}" for name, value in self.after.items()]
        if self.coarse != self.grid:
            changes.append(f"{_grid(self.coarse)} to {_grid(self.grid)}")
        return ", ".join(changes) or "the same"


CASES = (
    Case(problem="solo12-jump"),
    Case(problem="solo12-jump", after={"distance": 0.33}),
    Case(problem="solo12-jump", after={"distance": 0.45}),
    Case(problem="solo12-jump", after={"flight": 0.36}),
    Case(problem="solo12-jump", after={"yaw": "40deg", "height": 0.1}),
    Case(problem="solo12-jump", coarse=(None, 25), grid=(None, 50)),
    Case(problem="solo12-jump", grid=("radau:3", 50)),
    Case(problem="ur5-reach", after={"x": 0.33}),
    Case(problem="ur5-reach", after={"x": 0.35}),
    Case(problem="ur5-reach", after={"duration": 0.8}),
    Case(problem="ur5-reach", coarse=("legendre:1", 10), grid=("legendre:3", 60)),
    Case(problem="hopper-hop", after={"distance": 0.22}),
    Case(problem="hopper-hop", coarse=(None, 20), grid=(None, 50)),
    Case(problem="quadruped-trot", after={"speed": 0.64}),
    Case(problem="biped-squat", after={"depth": 0.224}),
    Case(problem="biped-walk", after={"length": 0.21}),
    Case(problem="biped-walk", after={"length": 0.26}),
    Case(problem="solo12-slope", coarse=(None, 20), grid=(None, 30)),
    Case(problem="talos-wall", coarse=(None, 16), grid=(None, 24)),
)
# Solved to the grade, and again from there.
RESTARTED = (
    ("biped-jump-up", "g1"),
    ("biped-jump-forward", "talos"),
    ("quadruped-stairs", "hyq"),
    ("quadruped-box-up", "laikago"),
    ("quadruped-jump-up", "go2"),
    ("arm-pick-place", "kinova"),
)
# From a guess that stands still instead of the default one.
STILL: tuple[tuple[str, tuple[Grid, ...]], ...] = (
    ("solo12-jump", (("legendre:2", 15), ("legendre:2", 50))),
    ("solo12-flip", (("legendre:2", 25), ("legendre:2", 50))),
    ("biped-walk", (("legendre:2", 14), ("legendre:2", 32))),
)


def _grid(grid: Grid) -> str:
    scheme, intervals = grid
    return f"{scheme or 'default'}@{intervals or 'default'}"


@click.command("warm-starts")
@click.option("--repeat", default=3, show_default=True, help="Solves of which the median time is taken.")
@click.option("--only", default="", help="Problems whose name has this text.")
@solver_option
def warm_starts(repeat: int, only: str, solver: str) -> None:
    """Other parameters, grids and schemes; iterations and time to the end, and until rows hold to 1e-3."""
    head("problem", "what changes", "default guess", "start", "start, to 1e-3", "objective differs by")
    for case in CASES:
        if only not in case.problem:
            continue
        first = solve(
            problems.load(case.problem),
            solver=solver,
            transcription=case.coarse[0],
            intervals=case.coarse[1],
        )
        after = problems.load(case.problem, **case.after)
        runs = []
        for start in (None, first):
            prepared = prepare(after, transcription=case.grid[0], intervals=case.grid[1], start=start)
            runs.append([timed(prepared, solver=solver) for _ in range(repeat)])
        cold, warm = runs
        differ = warm[0].result.objective / cold[0].result.objective - 1
        row(case.problem, case.title, _cost(cold), _cost(warm), _feasible(warm), f"{differ:+.1e}")
    click.echo("\nLadders from standing still:\n")
    head("problem", "grids", "finest grid alone", "all grids", "of it")
    for name, rungs in STILL:
        if only in name:
            found = solve_ladder(standing_still(problems.load(name)), rungs, compare=True, solver=solver)
            assert found.cold is not None
            both = (total_effort([found.cold]), found.to_dict()["total"])
            own = (f"{figures['iterations']}, {figures['wall_time_s']:.2f} s" for figures in both)
            each = ", ".join(str(total_effort([rung])["iterations"]) for rung in found.rungs)
            row(name, ", ".join(map(_grid, rungs)), *own, each)


def _cost(runs: list[Timed]) -> str:
    failed = "" if all(run.solved for run in runs) else f" {runs[0].result.status.word}"
    return f"{runs[0].result.iterations}, {median([run.seconds for run in runs]):.3f} s{failed}"


def _feasible(runs: list[Timed]) -> str:
    found = [run.feasible for run in runs if run.feasible is not None]
    return f"{found[0][0]}, {median([seconds for _, seconds in found]):.3f} s" if found else ""


@click.command()
def restarts() -> None:
    """Iterations by round to the grade: from the default guess, and from the solution of that."""
    head("pair", "default guess", "its solution")
    for name, robot in RESTARTED:
        first = graded(problems.load(name, robot=robot))
        again = graded(problems.load(name, robot=robot), start=first)
        counts = (", ".join(str(each.iterations) for each in own.statistics.rounds) for own in (first, again))
        row(f"`{name}` {robot}", *counts)
