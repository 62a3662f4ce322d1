"""Every measurement as a subcommand.

uv run python -m scripts.measure --help
OMP_NUM_THREADS=1 uv run python -m scripts.measure models --only hopper
"""

import contextlib
import functools
import importlib
import io
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import click

from scripts import documents, measure

DOCS = Path(__file__).parents[2] / "docs"


def _commands() -> Iterator[click.Command]:
    """The commands of all modules beside this one."""
    for module in pkgutil.iter_modules(measure.__path__):
        if module.name != "__main__":
            values = vars(importlib.import_module(f"{measure.__name__}.{module.name}")).values()
            yield from (value for value in values if isinstance(value, click.Command))


def _writing(command: click.Command) -> click.Command:
    """The command with --write: its output goes into the page that has its marker, or into its CSV file."""
    measured = command.callback
    if measured is None:
        return command

    @functools.wraps(measured)
    def written(write: bool, **arguments: object) -> None:
        if not write:
            measured(**arguments)
            return
        marker, output = str(command.name), io.StringIO()
        pages = [page for page in DOCS.rglob("*.md") if f"<!-- {marker} -->" in page.read_text()]
        data = DOCS / "data" / f"{marker}.csv"
        if not pages and not data.exists():
            raise click.ClickException(f"no page has the marker <!-- {marker} -->, and {data} does not exist")
        with contextlib.redirect_stdout(output):
            measured(**arguments)
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


@click.group(commands={command.name: _writing(command) for command in _commands()})
def main() -> None:
    """Measure what the documents cite; tables are Markdown."""


if __name__ == "__main__":
    main()
