"""``trajopt bench``: many solves, timed and compared."""

import click

from trajopt.cli.commands import LazyGroup

COMMANDS = {
    "outside": "trajopt.cli.outside:outside",
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
