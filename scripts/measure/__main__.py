"""Every measurement as a subcommand.

uv run python -m scripts.measure --help
OMP_NUM_THREADS=1 uv run python -m scripts.measure models --only hopper
"""

import contextlib
import functools
import io
from pathlib import Path

import click

from scripts import documents
from scripts.measure import (
    clearance,
    descriptions,
    discovery,
    grades,
    guesses,
    hands,
    heel_toe,
    infeasible,
    linear_systems,
    models,
    object_places,
    objects,
    outside,
    robustness,
    rooms,
    scenes,
    steering,
    steering_arms,
    steering_disturbances,
    steering_motions,
    suite,
)

DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = (
    models.models,
    models.bases,
    models.goals,
    models.smoothing,
    models.transfers,
    models.jump_range,
    objects.objects,
    objects.objects_found,
    object_places.object_places,
    outside.outside,
    descriptions.descriptions,
    discovery.discovery,
    discovery.gaits_by_speed,
    discovery.goals,
    grades.grades,
    guesses.guesses,
    hands.hands,
    heel_toe.heel_toe,
    heel_toe.longest_steps,
    infeasible.infeasible,
    linear_systems.linear_systems,
    linear_systems.scaling,
    scenes.scenes,
    steering.commands,
    steering.bipeds,
    steering.pushed,
    steering_disturbances.disturbed,
    steering_disturbances.carried,
    steering.gait_changes,
    steering_disturbances.rough,
    steering_motions.replanned,
    steering_arms.targets,
    suite.suite,
    suite.library,
    suite.tracking,
    clearance.clearance,
    robustness.robustness,
    rooms.tests,
)


def _writing(command: click.Command) -> click.Command:
    """The command with --write: its output goes into the page of the documents that has its marker."""
    measure = command.callback
    if measure is None:
        return command

    @functools.wraps(measure)
    def written(write: bool, **arguments: object) -> None:
        if not write:
            measure(**arguments)
            return
        marker, output = str(command.name), io.StringIO()
        pages = [page for page in DOCS.rglob("*.md") if f"<!-- {marker} -->" in page.read_text()]
        if not pages:
            raise click.ClickException(f"no page of {DOCS} has the marker <!-- {marker} -->")
        with contextlib.redirect_stdout(output):
            measure(**arguments)
        for page in pages:
            page.write_text(documents.written(page.read_text(), marker, output.getvalue()))
            click.echo(page)

    command.callback = written
    command.params.append(
        click.Option(["--write"], is_flag=True, help="Write into the page that has its marker.")
    )
    return command


@click.group(commands={command.name: _writing(command) for command in COMMANDS})
def main() -> None:
    """Measure what the documents cite; tables are Markdown."""


if __name__ == "__main__":
    main()
