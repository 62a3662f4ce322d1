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
    batches,
    clearance,
    control,
    descriptions,
    discovery,
    grades,
    guesses,
    hands,
    heel_toe,
    infeasible,
    least_time,
    linear_systems,
    machine,
    models,
    object_places,
    objects,
    outside,
    pages,
    robustness,
    rolling,
    rooms,
    scenes,
    shapes,
    steering,
    steering_arms,
    steering_disturbances,
    steering_fddp,
    steering_gains,
    steering_motions,
    suite,
    two_stage,
    viewing,
    warm_starts,
)

DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = (
    batches.batches,
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
    two_stage.two_stage,
    descriptions.descriptions,
    discovery.discovery,
    discovery.gaits_by_speed,
    discovery.goals,
    discovery.starts,
    discovery.slacks,
    discovery.sorters,
    grades.grades,
    guesses.guesses,
    hands.hands,
    heel_toe.heel_toe,
    heel_toe.longest_steps,
    infeasible.infeasible,
    least_time.least_time,
    least_time.arm_rounds,
    linear_systems.linear_systems,
    linear_systems.fronts,
    linear_systems.scaling,
    linear_systems.barrier,
    scenes.scenes,
    shapes.shapes,
    steering.commands,
    steering.bipeds,
    steering.pushed,
    steering_disturbances.disturbed,
    steering_disturbances.carried,
    steering.gait_changes,
    steering_disturbances.rough,
    steering.horizons,
    steering_motions.replanned,
    steering_arms.targets,
    steering_fddp.fddp,
    steering_gains.gains,
    suite.suite,
    suite.library,
    suite.rounds,
    suite.tracking,
    clearance.clearance,
    control.gaits,
    control.ticks,
    control.walks,
    warm_starts.warm_starts,
    warm_starts.restarts,
    robustness.robustness,
    rolling.rolling,
    rooms.tests,
    machine.compilation,
    machine.pinned,
    pages.pages,
    viewing.pictures,
    viewing.watching,
)


def _writing(command: click.Command) -> click.Command:
    """The command with --write: its output goes into the page that has its marker, or into its CSV file."""
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
        data = DOCS / "data" / f"{marker}.csv"
        if not pages and not data.exists():
            raise click.ClickException(f"no page has the marker <!-- {marker} -->, and {data} does not exist")
        with contextlib.redirect_stdout(output):
            measure(**arguments)
        for page in pages:
            page.write_text(documents.written(page.read_text(), marker, output.getvalue()))
            click.echo(page)
        if data.exists():
            documents.write_csv(data, output.getvalue())
            click.echo(data)

    command.callback = written
    command.params.append(
        click.Option(["--write"], is_flag=True, help="Write into the page with its marker, or its CSV file.")
    )
    return command


@click.group(commands={command.name: _writing(command) for command in COMMANDS})
def main() -> None:
    """Measure what the documents cite; tables are Markdown."""


if __name__ == "__main__":
    main()
