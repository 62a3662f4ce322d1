"""The published fronts: four sweeps, their tables into the package and the docs.

uv run python -m scripts.publish_fronts              # all, about 20 minutes on one core of a quiet machine
uv run python -m scripts.publish_fronts solo12-jump  # one of them
uv run python -m scripts.publish_fronts --resume     # go on after an interruption

Tables go to trajopt/sweep/fronts and docs/front, plots to docs/front.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import click

from trajopt.sweep.front import FOLDER
from trajopt.sweep.tables import SETTINGS

DOCS = Path(__file__).parent.parent / "docs" / "front"
WORK = Path("fronts-work")


@dataclass(frozen=True)
class Published:
    """A front: its name, and the arguments of its sweep."""

    name: str
    arguments: tuple[str, ...]


PUBLISHED = (
    Published("ur5-reach", ("ur5-reach",)),
    Published("solo12-jump", ("solo12-jump",)),
    Published("quadruped-trot", ("quadruped-trot",)),
    Published("biped-squat", ("biped-squat",)),
)


@click.command()
@click.argument("names", nargs=-1)
@click.option("--resume", is_flag=True, help="Go on where an interrupted sweep ended.")
def main(names: tuple[str, ...], resume: bool) -> None:
    """Run the sweeps and put their tables and plots where they are read."""
    chosen = [front for front in PUBLISHED if not names or front.name in names]
    if not chosen:
        raise click.BadParameter(f"allowed: {', '.join(front.name for front in PUBLISHED)}")
    for target in (DOCS, FOLDER):
        target.mkdir(parents=True, exist_ok=True)
    for front in chosen:
        folder = WORK / front.name
        command = ["sweep", *front.arguments, "--output-dir", str(folder)] + ["--resume"] * resume
        click.echo(f"trajopt {' '.join(command)}")
        with (DOCS / f"{front.name}.txt").open("w", encoding="utf-8") as table:
            status = subprocess.run(
                [sys.executable, "-m", "trajopt", *command], stdout=table, check=False
            ).returncode
        if status:
            raise click.ClickException(f"the sweep ended with exit status {status}")
        shutil.copyfile(folder / SETTINGS, FOLDER / f"{front.name}.csv")
        shutil.copyfile(folder / SETTINGS, DOCS / f"{front.name}.csv")
        shutil.copyfile(folder / "front.png", DOCS / f"{front.name}.png")


if __name__ == "__main__":
    main()
