"""Problems with published optima, solved and compared."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.table import Table

from trajopt.problem.problem import PublishedOptimum
from trajopt.solving.solving import solve
from trajopt.study.display import figure_table

# The scheme is exact for the polynomials of these problems; switches of the input fall on its nodes or are
# resolved by this many intervals.
TRANSCRIPTION, INTERVALS = "legendre:3", 60


@dataclass(frozen=True, kw_only=True)
class OptimumResult:
    """The result for a published optimum. apart: relative difference. seconds: of the solver."""

    name: str
    quantity: str
    published: float
    found: float
    apart: float
    tolerance: float
    converged: bool
    iterations: int
    intervals: int
    seconds: float
    source: str

    @property
    def agrees(self) -> bool:
        """Whether the solve converged to the published value within the tolerance."""
        return self.converged and abs(self.apart) <= self.tolerance

    def to_dict(self) -> dict[str, Any]:
        """JSON-able fields."""
        return {**asdict(self), "agrees": self.agrees}


def compared(optima: Sequence[PublishedOptimum]) -> Iterator[OptimumResult]:
    """Solve each problem and compare its value with the published one."""
    for optimum in optima:
        solution = solve(optimum.build(), transcription=TRANSCRIPTION, intervals=INTERVALS)
        found = optimum.value(solution)
        yield OptimumResult(
            name=optimum.name,
            quantity=optimum.quantity,
            published=optimum.published,
            found=found,
            apart=found / optimum.published - 1.0,
            tolerance=optimum.tolerance,
            converged=solution.converged,
            iterations=solution.statistics.iterations,
            intervals=solution.n_intervals,
            seconds=solution.statistics.wall_time_s,
            source=optimum.source,
        )


def comparison_table(comparisons: Sequence[OptimumResult]) -> Table:
    """One row per problem."""
    rows = [
        {
            "problem": one.name,
            "quantity": one.quantity,
            "published": f"{one.published:.7g}",
            "found": f"{one.found:.7g}",
            "apart": f"{one.apart:+.1e}",
            "agrees": "yes" if one.agrees else "NO",
            "iter": str(one.iterations),
            "time": f"{one.seconds:.2f} s",
            "intervals": str(one.intervals),
        }
        for one in comparisons
    ]
    return figure_table(rows, ("problem", "quantity", "agrees"), whole=("problem",))
