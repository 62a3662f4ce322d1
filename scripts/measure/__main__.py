"""Every measurement as a subcommand.

uv run python -m scripts.measure --help
OMP_NUM_THREADS=1 uv run python -m scripts.measure models --only hopper
"""

import click

from scripts.measure import (
    batches,
    clearance,
    control,
    grades,
    guesses,
    infeasible,
    linear_systems,
    machine,
    models,
    pages,
    programs,
    robustness,
    scenes,
    shapes,
    two_stage,
    viewing,
    warm_starts,
)

COMMANDS = (
    batches.batches,
    models.models,
    models.bases,
    models.goals,
    models.jump_range,
    two_stage.two_stage,
    grades.grades,
    guesses.guesses,
    infeasible.infeasible,
    linear_systems.linear_systems,
    scenes.scenes,
    shapes.shapes,
    clearance.clearance,
    control.gaits,
    control.ticks,
    control.walks,
    warm_starts.warm_starts,
    programs.programs,
    robustness.robustness,
    machine.compilation,
    machine.pinned,
    pages.pages,
    viewing.pictures,
    viewing.watching,
)


@click.group(commands={command.name: command for command in COMMANDS})
def main() -> None:
    """Measure what the documents cite; tables are Markdown."""


if __name__ == "__main__":
    main()
