"""Problems with published optima, and what is found."""

import click

from scripts.measure.shared import head, row
from trajopt.problem.catalogue import published_optima
from trajopt.study.published import compared

# Rounding of sums over the points of a mesh.
ROUNDING = 1e-12


@click.command()
def outside() -> None:
    """A line for each problem of `trajopt bench outside`."""
    head("problem", "quantity", "published", "found", "apart", "intervals", "iterations", "solver", "source")
    for one in compared(published_optima()):
        apart = f"{one.apart:+.0e}" if abs(one.apart) > ROUNDING else "0"
        values = one.name, one.quantity, f"{one.published:.7g}", f"{one.found:.7g}", apart
        row(*values, one.intervals, one.iterations, f"{1e3 * one.seconds:.0f} ms", one.source)
