"""``trajopt bench outside``: problems with published optima."""

import click

from trajopt.cli.input import NOT_REACHED, json_option
from trajopt.cli.report import say, to_json


@click.command("outside")
@json_option
def outside(as_json: bool) -> int:
    """Solve problems with published optima and compare.

    Exit status 1 when a value is not reached within its tolerance.
    """
    from rich.console import Console

    from trajopt.problem.catalogue import published_optima
    from trajopt.study.published import compared, comparison_table

    comparisons = list(compared(published_optima()))
    if as_json:
        say(to_json([one.to_dict() for one in comparisons]))
    else:
        Console(width=140).print(comparison_table(comparisons))
    return 0 if all(one.agrees for one in comparisons) else NOT_REACHED
