"""What the measurements share: timed solves, Markdown tables."""

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click
import numpy as np

from trajopt import Solution, check
from trajopt.solvers.drivers import SOLVERS, run_solver
from trajopt.solvers.result import Result, StoppingCriteria
from trajopt.solvers.status import Status
from trajopt.solving.solving import PreparedProblem

# Standard deviation of the noise on a guess, scaled units: that of `trajopt suite`.
NOISE = 0.1
PASSES = "passes"

solver_option = click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt", show_default=True)


@dataclass(frozen=True, kw_only=True)
class Timed:
    """A solver's result and its CPU time in s."""

    result: Result
    seconds: float

    @property
    def solved(self) -> bool:
        """The solver's verdict."""
        return self.result.status is Status.SOLVED


def timed(
    prepared: PreparedProblem,
    start: np.ndarray | None = None,
    solver: str = "ipopt",
    stop: StoppingCriteria | None = None,
) -> Timed:
    """Solve from scaled variables (n_unknowns,), by default from the guess."""
    begun, first = time.process_time(), prepared.guess if start is None else start
    result = run_solver(
        prepared.nlp, first, solver, stop or StoppingCriteria(), {}, lambda *_: True, prepared.warm
    )
    return Timed(result=result, seconds=time.process_time() - begun)


def verdict(solution: Solution) -> str:
    """What the check says of a solution: "passes", or the worst figure over its tolerance."""
    report = check(solution)
    name, used = report.worst()
    return f"{used:.2g} times `{name}`" if report.failures() else PASSES


def sizes(solution: Solution) -> list[str]:
    """Variables, rows, and of all rounds iterations and time in s."""
    statistics, rounds = solution.statistics, solution.statistics.rounds
    counts = statistics.variables, statistics.constraints, sum(each.iterations for each in rounds)
    return [*map(str, counts), f"{sum(each.wall_time_s for each in rounds):.2f}"]


def named(name: str, values: Mapping[str, Any]) -> str:
    """A problem with its parameters, as on the command line."""
    return " ".join([name, *(f"{key}={value}" for key, value in values.items())])


def median(values: Sequence[float]) -> float:
    """The median, NaN of nothing."""
    return statistics.median(values) if values else float("nan")


def head(*titles: str) -> None:
    """Begin a table."""
    row(*titles)
    row(*["---"] * len(titles))


def row(*cells: object) -> None:
    """Print a line of a table at once."""
    click.echo(f"| {' | '.join(map(str, cells))} |")
