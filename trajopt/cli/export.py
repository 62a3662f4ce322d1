"""``trajopt export``: a solution at an even rate for programs and robots, or its model for MuJoCo."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from typing import Any

import click

from trajopt.cli.input import default_option, is_given
from trajopt.errors import InputError
from trajopt.solution.output import check_apart, check_output

# Endings of files by format.
ENDINGS = {"csv": ".csv", "parquet": ".parquet", "npz": ".npz", "mjcf": ".xml"}
# Options that only samples have.
OF_SAMPLES = ("rate", "quaternion", "base_velocity")


@click.command("export")
@click.argument("file", type=Path)
@click.option(
    "--format",
    type=click.Choice(tuple(ENDINGS)),
    help="Form of the file.  [default: by the ending of --output, else csv]",
)
@default_option("--rate", 500.0, "HZ", "Samples a second.", kind=click.FLOAT)
@click.option(
    "--output",
    "-o",
    type=Path,
    metavar="OUT",
    help="File to write.  [default: FILE-500hz.csv, of a model FILE.xml]",
)
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
    file: Path,
    format: str | None,
    output: Path | None,
    rate: float,
    **conventions: Any,
) -> None:
    """Write the motion in FILE at an even rate, for a robot.

    Times, q, v, a, torques, contacts and contact forces. Columns have names, such as q/FL_hip_joint; units
    are SI. Where values jump, as at a touchdown, those after it are written. The format mjcf is the robot and
    its ground for MuJoCo, as simulate uses them.
    """
    from trajopt.solution.solution import Solution

    form = _format(format, output)
    samples = form != "mjcf"
    target = output or Path(f"{file.stem}-{rate:g}hz{ENDINGS[form]}" if samples else f"{file.stem}.xml")
    check_apart([target], [file])
    _refuse_solution_file(check_output(target))
    if samples:
        plan = Solution.load(file)
        if not plan.success:
            warnings.warn(f"{file} is not a success: {plan.meta['status']}", UserWarning, stacklevel=2)
        motion = plan.sample(rate, **conventions)
        click.echo(f"{motion.save(target)}: {len(motion.t)} samples at {rate:g} Hz")
    else:
        from trajopt.simulation.mjcf import write_mjcf

        _refuse_options()
        click.echo(write_mjcf(file, target))


def _format(format: str | None, output: Path | None) -> str:
    """Format of the file to write; raises `InputError` where its ending is another one's, or unknown."""
    if output is None:
        return format or "csv"
    allowed = {ending: name for name, ending in ENDINGS.items() if format in (None, name)}
    if output.suffix.lower() not in allowed:
        raise InputError(f"--output {output} ends with '{output.suffix}'", f"allowed: {', '.join(allowed)}")
    return allowed[output.suffix.lower()]


def _refuse_options() -> None:
    """Raise `InputError` where options of samples are given for a model."""
    for name in OF_SAMPLES:
        if is_given(name):
            raise InputError(f"--{name.replace('_', '-')} is of no use for mjcf", "allowed: --output")


def _refuse_solution_file(target: Path) -> None:
    """Raise `InputError` where a solution would be replaced by its samples."""
    from trajopt.errors import SolutionFileError
    from trajopt.solution.file import read_solution_file

    if target.suffix.lower() == ".npz" and target.exists():
        with contextlib.suppress(SolutionFileError):
            read_solution_file(target)
            raise InputError(f"{target} is a solution file", "allowed: another name for the output")
