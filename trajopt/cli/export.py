"""``trajopt export``: a solution at an even rate, for programs and robots."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import click

from trajopt.cli.input import default_option
from trajopt.errors import InputError
from trajopt.solution.output import check_apart, check_output

# Formats, which are the endings of files, too.
FORMATS = ("csv", "parquet", "npz")


@click.command("export")
@click.argument("file", type=Path)
@click.option(
    "--format",
    type=click.Choice(FORMATS),
    help="Form of the file.  [default: by the ending of --output, else csv]",
)
@default_option("--rate", 500.0, "HZ", "Samples a second.", kind=click.FLOAT)
@click.option("--output", "-o", type=Path, metavar="OUT", help="File to write.  [default: FILE-500hz.csv]")
@click.option(
    "--quaternion",
    type=click.Choice(("xyzw", "wxyz")),
    default="xyzw",
    show_default=True,
    help="Order of quaternions.",
)
@click.option(
    "--base-velocity",
    type=click.Choice(("body", "world")),
    default="body",
    show_default=True,
    help="Axes of the velocity and acceleration of a moving base.",
)
def export_command(
    file: Path, format: str | None, rate: float, output: Path | None, **conventions: Any
) -> None:
    """Write the motion in FILE at an even rate: times, q, v, a, torques, contacts and contact forces.

    Columns have names, such as q/FL_hip_joint; units are SI. Where values jump, as at a touchdown, those
    after it are written.
    """
    from trajopt.solution.solution import Solution

    target = _target(file, format, output, rate)
    check_apart([target], [file])
    _refuse_solution_file(check_output(target))
    motion = Solution.load(file).sample(rate, **conventions)
    click.echo(f"{motion.save(target)}: {len(motion.t)} samples at {rate:g} Hz")


def _target(file: Path, format: str | None, output: Path | None, rate: float) -> Path:
    """File to write; raises `InputError` where its ending is that of another format, or of none."""
    if output is None:
        return Path(f"{file.stem}-{rate:g}hz.{format or FORMATS[0]}")
    allowed = [f".{name}" for name in FORMATS if format in (None, name)]
    if output.suffix.lower() not in allowed:
        raise InputError(f"--output {output} ends with '{output.suffix}'", f"allowed: {', '.join(allowed)}")
    return output


def _refuse_solution_file(target: Path) -> None:
    """Raise `InputError` where a solution would be replaced by its samples."""
    from trajopt.errors import SolutionFileError
    from trajopt.solution.file import read_solution_file

    if target.suffix.lower() == ".npz" and target.exists():
        with contextlib.suppress(SolutionFileError):
            read_solution_file(target)
            raise InputError(f"{target} is a solution file", "allowed: another name for the output")
