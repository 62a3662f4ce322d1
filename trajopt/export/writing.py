"""Export of one or several motions to a named format, completely or not at all."""

from collections.abc import Iterable
from pathlib import Path

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.errors import expanded
from trajopt.export.exported_motion import sample_cycles
from trajopt.export.formats import format_named, keyword_arguments, require_count, require_options
from trajopt.motion.input import SolutionOrFile, solutions_of
from trajopt.motion.output import (
    check_apart,
    check_folder,
    check_output,
    replacing,
    replacing_folder,
    require_ending,
)
from trajopt.motion.samples import warn_of_payloads
from trajopt.motion.solution import Solution


@checked
def export_motion(
    solution: SolutionOrFile | Iterable[SolutionOrFile],
    format: str,
    path: str | Path,
    rate: Positive | None = None,
    cycles: PositiveCount = 1,
    *,
    mjcf: str | Path | None = None,
    task: str | None = None,
    fields: str | None = None,
) -> Path:
    """Write one or several motions in the format of another tool; return the path of the file or folder.

    Args:
        solution: the plan, or the path of its file; several of them if the format takes several.
        format: name of the format, such as "isaaclab-amp"; docs/exports.md lists them.
        path: of the file or folder, which is replaced.
        rate: samples per second, Hz; None: that of the format, 50, or 500 for torques to play back.
        cycles: of a periodic plan, each continuing the previous one.
        mjcf: MJCF of the simulator's robot, for formats in a simulator's order.
        task: what the robot does, in words, for data sets; None: the problem's name.
        fields: of the points of a joint trajectory, separated by commas; None: positions, velocities,
            accelerations and effort.

    Payloads are left out, with a warning.

    Raises:
        InputError: for an unknown format or option, motions that the format cannot hold, and a path that
            cannot be written or is a folder with something other than such an export.
    """
    given = [solution] if isinstance(solution, Solution | str | Path) else list(solution)
    chosen, options, target = (
        format_named(format),
        keyword_arguments(mjcf=mjcf, task=task, fields=fields),
        expanded(path),
    )
    require_options(format, chosen, options)
    require_count(format, chosen, len(given))
    check_apart([target], [Path(one) for one in given if isinstance(one, str | Path)])
    if chosen.ending:
        require_ending(target, chosen.ending)
        check_output(target)
    else:
        check_folder(target, chosen.marker)
    sampled = chosen.rate if rate is None else rate
    plans = solutions_of(given)
    warn_of_payloads(plans, format)
    motions = [sample_cycles(plan, sampled, cycles, even=chosen.even) for plan in plans]
    place = replacing(target) if chosen.ending else replacing_folder(target, chosen.marker)
    with place as unfinished:
        chosen.load_writer()(motions, unfinished, options)
    return target
