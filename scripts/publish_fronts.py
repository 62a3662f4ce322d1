"""The published fronts: four sweeps, their tables and plots into the docs.

uv run python -m scripts.publish_fronts              # all, about 25 minutes on a quiet machine
uv run python -m scripts.publish_fronts solo12-jump  # one of them
uv run python -m scripts.publish_fronts --resume     # continue after an interruption

Tables and plots go to docs/front, and the sections between the markers of docs/front.md are rewritten: the
fronts, and how much pinned workers disturb each other.
"""

from __future__ import annotations

import csv
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from scripts.documents import written
from scripts.measure import machine
from trajopt.study.sweep.tables import SETTINGS

DOCUMENT = Path(__file__).parent.parent / "docs" / "front.md"
DOCS = DOCUMENT.parent / "front"
WORK = Path("build") / "fronts"
# Factors for which every front is queried: faster, and more accurate, than the default.
FASTER, MORE_ACCURATE = 5, 100
# Runs of one solve alone and on all cores.
REPEATS = 15
WIDTH = 120


@dataclass(frozen=True)
class Published:
    """A front: its name, a description, and the arguments of its sweep."""

    name: str
    what: str
    arguments: tuple[str, ...]

    @property
    def table(self) -> Path:
        """Its rows in the docs."""
        return DOCS / f"{self.name}.csv"


# More settings for the fast end of the jump's front.
FAST = (
    "legendre:2@6 1e-2",
    "legendre:3@7 1e-2",
    "legendre:4@6 1e-2",
    "legendre:2@8 1e-2",
    "legendre:2@8 1e-1",
)


def _also(settings: Sequence[str]) -> tuple[str, ...]:
    return tuple(word for setting in settings for word in ("--also", setting))


PUBLISHED = (
    Published("ur5-reach", "an arm", ("ur5-reach",)),
    Published("solo12-jump", "a quadruped's jump", ("solo12-jump", *_also(FAST))),
    Published("quadruped-trot", "a gait, periodic", ("quadruped-trot",)),
    Published("biped-walk", "a biped", ("biped-walk", "--repeats", "1")),
)


@click.command()
@click.argument("names", nargs=-1)
@click.option("--resume", is_flag=True, help="Go on where an interrupted sweep ended.")
@click.option("--only-document", is_flag=True, help="Run nothing: write the section from the tables.")
def main(names: tuple[str, ...], resume: bool, only_document: bool) -> None:
    """Run the sweeps and copy their tables and plots to the docs."""
    unknown = set(names) - {front.name for front in PUBLISHED}
    if unknown:
        raise click.BadParameter(f"allowed: {', '.join(front.name for front in PUBLISHED)}")
    DOCS.mkdir(exist_ok=True)
    for front in PUBLISHED:
        if not only_document and (not names or front.name in names):
            publish(front, resume)
    text = DOCUMENT.read_text(encoding="utf-8")
    parts = "\n".join(section(front) for front in PUBLISHED if front.table.exists())
    text = written(text, "fronts", parts)
    if not names and not only_document:
        found = machine.disturbance("solo12-jump", REPEATS)
        text = written(text, "pinned", "\n".join(f"    {line}" for line in found) + "\n")
    DOCUMENT.write_text(text, encoding="utf-8")


def publish(front: Published, resume: bool) -> None:
    """Run one sweep and copy what it wrote."""
    folder = WORK / front.name
    command = ["bench", "sweep", *front.arguments, "--output-dir", str(folder)] + ["--resume"] * resume
    click.echo(f"trajopt {shlex.join(command)}", err=True)
    done = subprocess.run(
        [sys.executable, "-m", "trajopt", *command], stdout=subprocess.PIPE, text=True, check=False
    )
    click.echo(done.stdout)
    if done.returncode:
        raise click.ClickException(f"the sweep ended with exit status {done.returncode}")
    (DOCS / f"{front.name}.txt").write_text(done.stdout, encoding="utf-8")
    shutil.copyfile(folder / SETTINGS, front.table)
    shutil.copyfile(folder / "runs.csv", DOCS / f"{front.name}-runs.csv")
    shutil.copyfile(folder / "front.png", DOCS / f"{front.name}.png")


def section(front: Published) -> str:
    """The section about a front: the settings on it, and what they gain over the default."""
    with front.table.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    best = sorted((row for row in rows if row["on_front"] == "1"), key=lambda row: float(row["time_s"]))
    default = next(row for row in rows if row["is_default"] == "1")
    lines = [
        f"### {front.name}, {front.what}",
        "",
        f"    uv run trajopt bench sweep {shlex.join(front.arguments)}",
        "",
        f"![{front.name}](front/{front.name}.png)",
        "",
        "| setting | time, s | over the default's | solved | error, m | objective gap |",
        "|---|---|---|---|---|---|",
        *(_row(row) for row in [*best, *([default] if default not in best else [])]),
        "",
        *textwrap.wrap(
            f"{_offer(best, default)} {len(rows)} settings were tried; all of them, and what dominates each, are in "
            f"[{front.name}.txt](front/{front.name}.txt) and [{front.name}.csv](front/{front.name}.csv).",
            WIDTH,
            break_on_hyphens=False,
        ),
        "",
    ]
    return "\n".join(lines)


def _row(row: dict[str, str]) -> str:
    name = f"`{row['label']}`" + (" (default)" if row["is_default"] == "1" else "")
    below = "" if row["on_front"] == "1" else f", dominated by `{row['dominated_by']}`"
    gap = f"{float(row['objective_gap']):+.1e}" if row["objective_gap"] else ""
    return (
        f"| {name}{below} | {float(row['time_s']):.3g} | {float(row['relative_time']):.2f} "
        f"| {row['solved']} of {row['runs']} | {float(row['error_m']):.1e} | {gap} |"
    )


def _offer(best: Sequence[dict[str, str]], default: dict[str, str]) -> str:
    """The settings of the front that are much faster, and much more accurate, than the default."""

    def times(name: str, row: dict[str, str]) -> float:
        return float(default[name]) / max(float(row[name]), 1e-300)

    text = f"The fastest setting is {times('time_s', best[0]):.0f} times faster than the default, "
    text += f"the finest {times('error_m', best[-1]):.0e} times more accurate."
    for row in [row for row in best if times("time_s", row) >= FASTER][-1:]:
        text += f" At least {FASTER} times faster: `{row['label']}`, {float(row['error_m']):.1e} m."
    for row in [row for row in best if times("error_m", row) >= MORE_ACCURATE][:1]:
        text += f" At least {MORE_ACCURATE} times more accurate: `{row['label']}`, "
        text += f"{float(row['relative_time']):.2f} times the default's time."
    return text


if __name__ == "__main__":
    main()
