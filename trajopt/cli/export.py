"""``trajopt export``: a solution at an even rate for robots and other tools, or its model for MuJoCo."""

import contextlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from trajopt.cli.input import (
    COUNT,
    choice_option,
    default_option,
    is_given,
    load_plan,
    option_group,
    output_option,
    value_option,
)
from trajopt.cli.report import say
from trajopt.errors import InputError
from trajopt.export.formats import FORMATS, OPTIONS, keyword_arguments, require_count, require_options
from trajopt.motion.output import check_apart, check_folder, check_output, require_ending

# Endings of files by format: samples of the solution, and its model.
ENDINGS = {"csv": ".csv", "parquet": ".parquet", "npz": ".npz", "mjcf": ".xml"}
# Options that only samples have, and that only motions in other tools' formats have.
OF_SAMPLES = ("quaternion", "base_velocity")
OF_MOTIONS = ("cycles", *OPTIONS)
# Samples a second in the formats above, for robots; motions for learning have fewer.
SAMPLE_RATE = 500.0
# Lines of the help: each motion format, and what it is for.
FORMAT_LINES = [f"  {name:{max(map(len, FORMATS))}}  {each.help}" for name, each in FORMATS.items()]


def _motion_option(name: str) -> Callable[..., Any]:
    """An option that some motion formats have, which its help names."""
    option = OPTIONS[name]
    knowing = ", ".join(sorted(key for key, each in FORMATS.items() if name in each.options))
    kind = Path if option.is_path else str
    return value_option(f"--{name.replace('_', '-')}", option.metavar, f"{option.help} ({knowing})", kind)


@click.command("export", epilog="\n".join(["\b", "Motion formats:", *FORMAT_LINES]))
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=Path)
@click.option(
    "--format",
    type=click.Choice((*ENDINGS, *FORMATS)),
    help="Form of the file.  [default: by the ending of --output, else csv]",
)
@value_option(
    "--rate", "HZ", "Samples a second.  [default: 500; of motion formats 50, but of mujoco 500]", click.FLOAT
)
@output_option(
    "OUT", "File or folder to write.  [default: FILE-500hz.csv, FILE.xml of a model, else FILE-FORMAT]"
)
@choice_option("--quaternion", ["xyzw", "wxyz"], "Order of quaternions in csv, parquet, npz.")
@choice_option(
    "--base-velocity",
    ["body", "world"],
    "Axes of the velocity and acceleration of a moving base in csv, parquet, npz.",
)
@default_option("--cycles", 1, "N", "Cycles of a periodic plan, in motion formats.", kind=COUNT)
@option_group(*map(_motion_option, OPTIONS))
def export_command(
    files: tuple[Path, ...],
    format: str | None,
    output: Path | None,
    rate: float | None,
    quaternion: str,
    base_velocity: str,
    cycles: int,
    **options: Any,
) -> None:
    """Write the motion in FILE at an even rate, for a robot or for another tool.

    csv, parquet, npz: times, q, v, a, torques, contacts and contact forces. Columns have names, such as
    q/FL_hip_joint; units are SI. Where values jump, as at a touchdown, those after it are written. mjcf is
    the robot and its ground for MuJoCo, as simulate uses them.
    """
    form = _format(format, output)
    if form in FORMATS:
        rate = FORMATS[form].rate if rate is None else rate
        _export_motions(files, form, output, rate, cycles, keyword_arguments(**options))
        return
    _refuse_options(form, OF_MOTIONS)
    if len(files) > 1:
        raise InputError(f"{len(files)} files for {form}", "allowed: one FILE")
    conventions = {"quaternion": quaternion, "base_velocity": base_velocity}
    _export_one(files[0], form, output, SAMPLE_RATE if rate is None else rate, conventions)


def _export_motions(
    files: Sequence[Path], form: str, output: Path | None, rate: float, cycles: int, given: dict[str, Any]
) -> None:
    """Write motions in the format of another tool."""
    from trajopt.export.writing import export_motion

    chosen = FORMATS[form]
    _refuse_options(form, OF_SAMPLES)
    require_options(form, chosen, given)
    require_count(form, chosen, len(files))
    target = output or Path(f"{files[0].stem}-{form}{chosen.ending}")
    check_apart([target], files)
    if chosen.ending:
        _refuse_solution_file(check_output(target))
    else:
        check_folder(target, chosen.marker)
    plans = [load_plan(file) for file in files]
    written = export_motion(plans, form, target, rate, cycles, **given)
    count = "1 motion" if len(plans) == 1 else f"{len(plans)} motions"
    say(f"{written}: {count} at {rate:g} Hz, {form}")


def _export_one(file: Path, form: str, output: Path | None, rate: float, conventions: dict[str, Any]) -> None:
    """Write the samples of a solution, or its model."""
    samples = form != "mjcf"
    target = output or Path(f"{file.stem}-{rate:g}hz{ENDINGS[form]}" if samples else f"{file.stem}.xml")
    check_apart([target], [file])
    _refuse_solution_file(check_output(target))
    if samples:
        from trajopt.motion.robot_motion import position_names, velocity_names
        from trajopt.motion.samples import warn_of_payloads

        plan = load_plan(file)
        warn_of_payloads([plan], form)
        same = {
            "quaternion": position_names(plan.model, "wxyz") == position_names(plan.model),
            "base_velocity": velocity_names(plan.model, "world") == velocity_names(plan.model),
        }
        for option in (name for name, unchanged in same.items() if unchanged and is_given(name)):
            what = f"--{option.replace('_', '-')} has no effect on {file}"
            raise InputError(what, "allowed: for a robot whose base moves")
        motion = plan.sample(rate, **conventions)
        say(f"{motion.save(target)}: {len(motion.t)} samples at {rate:g} Hz")
    else:
        from trajopt.simulation.mjcf import write_mjcf

        _refuse_options(form, ("rate", *OF_SAMPLES))
        say(write_mjcf(file, target))


def _format(format: str | None, output: Path | None) -> str:
    """Format of the file to write; raises `InputError` where its ending is another one's, or unknown."""
    if format in FORMATS:
        if output is not None and FORMATS[format].ending:
            require_ending(output, FORMATS[format].ending)
        return format
    if output is None:
        return format or "csv"
    allowed = {ending: name for name, ending in ENDINGS.items() if format in (None, name)}
    if output.suffix.lower() not in allowed:
        raise InputError(f"--output {output} ends with '{output.suffix}'", f"allowed: {', '.join(allowed)}")
    return allowed[output.suffix.lower()]


def _refuse_options(form: str, names: Iterable[str]) -> None:
    """Raise `InputError` where options are given that a format does not know."""
    for name in names:
        if is_given(name):
            allowed = "--output" if form == "mjcf" else "see trajopt export --help"
            raise InputError(f"--{name.replace('_', '-')} is of no use for {form}", f"allowed: {allowed}")


def _refuse_solution_file(target: Path) -> None:
    """Raise `InputError` where a solution would be replaced by its samples."""
    from trajopt.errors import SolutionFileError
    from trajopt.motion.file import read_solution_file

    if target.suffix.lower() == ".npz" and target.exists():
        with contextlib.suppress(SolutionFileError):
            read_solution_file(target)
            raise InputError(f"{target} is a solution file", "allowed: another name for the output")
