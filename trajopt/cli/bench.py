"""``trajopt bench``: many solves, timed and compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import click

from trajopt.cli.groups import LazyGroup

COMMANDS = {
    "reference": "trajopt.cli.reference:reference_command",
    "suite": "trajopt.cli.suite:suite",
    "sweep": "trajopt.cli.sweep:sweep",
}


class Bench(LazyGroup):
    """The commands of ``trajopt bench``."""

    modules: ClassVar[Mapping[str, str]] = COMMANDS


@click.command("bench", cls=Bench, context_settings={"help_option_names": ["-h", "--help"]})
def bench() -> None:
    """Solve many problems or settings, timed and compared."""
