"""``trajopt bench``: many solves, timed and compared."""

import click

from trajopt.cli.commands import LazyGroup
from trajopt.cli.input import NOT_REACHED, json_option
from trajopt.cli.report import say, to_json

COMMANDS = {
    "outside": "trajopt.cli.bench:outside",
    "reference": "trajopt.cli.reference:reference_command",
    "suite": "trajopt.cli.suite:suite",
    "sweep": "trajopt.cli.sweep:sweep",
}


@click.command(
    "bench",
    cls=LazyGroup,
    modules=COMMANDS,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
def bench() -> None:
    """Solve many problems or settings, timed and compared."""


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
