"""How errors fall with the step: local errors and open loop of every scheme, as a Markdown table.

uv run python -m scripts.accuracy_orders ur5-reach 8 16 32
"""

from __future__ import annotations

from collections.abc import Sequence

import click
import numpy as np

import trajopt
from trajopt.certify.accuracy.measures import measure
from trajopt.transcription.schemes import scheme
from trajopt_library import problems

SCHEMES = (
    *(f"legendre:{degree}" for degree in (1, 2, 3)),
    *(f"radau:{degree}" for degree in (1, 2, 3)),
    *("trapezoidal", "hermite-simpson", "semi-implicit-euler"),
)
# Far below the errors that are shown.
TOLERANCE = 1e-10


def row(problem: trajopt.Problem, name: str, grids: Sequence[int]) -> str:
    """One line of the table: errors on each grid, and the powers of the step with which they fall."""
    solved = [
        trajopt.solve(problem, transcription=name, intervals=n, compile="none", tolerance=TOLERANCE)
        for n in grids
    ]
    if not all(solution.success for solution in solved):
        return f"| `{name}` | not solved |"
    found = [measure(solution) for solution in solved]
    steps = np.log(np.array(grids[1:]) / np.array(grids[:-1]))
    cells = [f"`{name}`", str(scheme(name).order)]
    for errors in ([each.interval_error for each in found], [each.open_loop for each in found]):
        powers = np.log(np.array(errors[:-1]) / np.array(errors[1:])) / steps
        cells += [", ".join(f"{e:.1e}" for e in errors), ", ".join(f"{p:.1f}" for p in powers)]
    return f"| {' | '.join(cells)} |"


@click.command()
@click.argument("problem")
@click.argument("intervals", type=int, nargs=-1, required=True)
def main(problem: str, intervals: tuple[int, ...]) -> None:
    """Print the table of a problem on grids of so many intervals."""
    loaded = problems.load(problem)
    print("| scheme | order | local error, m | powers | open loop, m | powers |")
    print("|---|---|---|---|---|---|")
    for name in SCHEMES:
        print(row(loaded, name, intervals), flush=True)


if __name__ == "__main__":
    main()
