"""Input of the command line: options that commands share, NAME=VALUE settings, the files they name."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from typing_extensions import override

from trajopt.errors import InputError
from trajopt.solvers.drivers import SOLVERS

if TYPE_CHECKING:
    from trajopt.motion.solution import Solution
    from trajopt.problem.problem import Problem

_Command = TypeVar("_Command", bound=Callable[..., Any])
_Option = Callable[[_Command], _Command]
# Exit status of a command that ran but did not reach its goal.
NOT_REACHED = 1
# Solvers count in C's int.
LARGEST_INTEGER = 2**31 - 1
# Options of solvers that have one of the command's own.
LIMITS = {
    "tol": "--tolerance",
    "tolerance": "--tolerance",
    "max_iter": "--max-iterations",
    "max_wall_time": "--max-time",
}
# Arguments of commands that do not change the motion, and those whose values are NAME=VALUE already.
SAME_MOTION = {
    "problem", "output", "output_dir", "vary", "as_json", "watch", "log", "diagnosed", "explain",
    "threads", "compare", "nearest",
}  # fmt: skip
NAMED = {"settings", "solver_options"}
# Characters that are replaced in a file's name, and the most characters that it may have.
UNSAFE, LONGEST = re.compile(r"[^\w.=+,@-]+"), 200


class WholeNumber(click.ParamType):
    """A whole number from ``least`` to ``most``."""

    name = "whole number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    @override
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            number = int(value)
        except ValueError:
            self.fail(f"'{value}' is not a whole number", param, ctx)
        if not self.least <= number <= self.most:
            self.fail(f"{number} is not within {self.least} to {self.most}", param, ctx)
        return number


COUNT = WholeNumber(0, LARGEST_INTEGER)
# A finer mesh takes tens of gigabytes before solving starts; the least number depends on the problem.
GRID = WholeNumber(-LARGEST_INTEGER, 100_000)
THREADS = WholeNumber(1, 1024)


def value_option(name: str, metavar: str, help: str, kind: Any = None, **settings: Any) -> _Option:
    """Return an option that takes a value, text unless ``kind`` or a default say more."""
    return click.option(name, metavar=metavar, help=help, type=kind, **settings)


def default_option(
    name: str, default: Any, metavar: str, help: str, *, to: str = "", kind: Any = None, **settings: Any
) -> _Option:
    """Return an option with a default that its help shows; ``to`` names the command's argument."""
    names, settings = (name, to) if to else (name,), {"show_default": True, **settings}
    return click.option(*names, default=default, type=kind, metavar=metavar, help=help, **settings)


def choice_option(name: str, choices: Sequence[str], help: str) -> _Option:
    """Return an option with one of several values, the first by default."""
    return click.option(name, type=click.Choice(choices), default=choices[0], show_default=True, help=help)


def output_option(metavar: str, help: str, required: bool = False) -> _Option:
    """Return the option that names the file to write."""
    return click.option("-o", "--output", type=Path, metavar=metavar, help=help, required=required)


def is_given(name: str) -> bool:
    """Whether the option of that name is on the command line that runs."""
    source = click.get_current_context().get_parameter_source(name)
    return source is click.core.ParameterSource.COMMANDLINE


def option_group(*options: _Option) -> _Option:
    """Return a decorator that adds several options to a command, in the order in which they are listed."""

    def decorate(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
solver_option = default_option("--solver", "ipopt", "NAME", f"One of {', '.join(SOLVERS)}.")
threads_option = default_option(
    "--threads", 1, "N", "Threads for functions and linear systems.", kind=THREADS
)
grid_options = option_group(
    value_option("--transcription", "NAME", "Scheme, e.g. legendre:2.  [default: the problem's]"),
    value_option("--intervals", "N", "Number of intervals in all.  [default: the problem's]", GRID),
    solver_option,
)
tolerance_option = default_option("--tolerance", 1e-6, "TOL", "Solver tolerance.")
solver_options = option_group(
    default_option("--max-iterations", 500, "N", "Iteration limit of a solve.", kind=COUNT),
    default_option("--max-time", 600.0, "S", "Time limit of a solve, s."),
    threads_option,
    click.option(
        "--solver-option", "solver_options", multiple=True, metavar="NAME=VALUE", help="Option of the solver."
    ),
)
controller_option = choice_option(
    "--controller", ["joints", "whole-body"], "Feedback of single joints, or of the whole body."
)
hardware_options = option_group(
    value_option("--timestep", "S", "Longest step of the physics.  [default: derived]", float),
    default_option("--control-rate", 1000.0, "HZ", "Rate of the controller."),
    default_option("--friction-scale", 1.0, "X", "Factor on friction."),
    default_option("--mass-scale", 1.0, "X", "Factor on masses and inertias."),
    default_option("--noise", 0.0, "SIGMA", "Noise on the initial state, natural units."),
    default_option(
        "--sensor-noise", 0.0, "SIGMA", "Noise on the state measured at each tick, natural units."
    ),
    default_option("--seed", 0, "K", "Seed of what is random.", kind=COUNT),
    default_option("--delay", 0, "TICKS", "Whole ticks by which measurements are late.", kind=COUNT),
    default_option("--torque-step", 0.0, "NM", "Torques are rounded to multiples of this; 0: they are not."),
    default_option("--torque-rate", 0.0, "NM/S", "Fastest change of a torque; 0: no limit."),
    default_option(
        "--com-offset",
        (0.0, 0.0, 0.0),
        "X Y Z",
        "Offset of the robot's centre of mass, base frame, m.",
        kind=click.Tuple([float, float, float]),
    ),
)
layout_options = option_group(
    click.option(
        "--side-by-side",
        "layout",
        flag_value="side-by-side",
        default=None,
        help="Show files side by side, not overlaid.  [default for different robots]",
    ),
    click.option("--label", "labels", multiple=True, metavar="NAME", help="Label of each file, in order."),
)


def chosen_problem(name: str, settings: Sequence[str]) -> Problem:
    """Build the problem of that name with repeated ``--set NAME=VALUE``; raises `InputError`."""
    from trajopt.problem.catalogue import family

    return family(name).load(parse_settings(settings, "--set"))


def load_plan(file: Path) -> Solution:
    """The solution in a file; warns where it is not a success."""
    from trajopt.motion.solution import Solution

    plan = Solution.load(file)
    if not plan.success:
        warnings.warn(f"{file} is not a success: {plan.statistics.status}", UserWarning, stacklevel=2)
    return plan


def parse_settings(settings: Sequence[str], option: str) -> dict[str, str]:
    """Values by name of repeated NAME=VALUE; raises `InputError` for a wrong form or a name given twice."""
    values: dict[str, str] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        name = name.strip()
        if not (name and equals):
            raise InputError(f"{option} '{setting}' has the wrong form", "allowed: NAME=VALUE")
        if name in values:
            raise InputError(f"{option} gives '{name}' twice: {values[name]} and {value}", "allowed: once")
        values[name] = value
    return values


def options_of(settings: Sequence[str]) -> dict[str, str | int | float]:
    """Solver options by name, as whole numbers, numbers or words; raises `InputError`."""
    values = parse_settings(settings, "--solver-option")
    for name in LIMITS.keys() & values.keys():
        raise InputError(f"--solver-option {name} is an option of the command", f"allowed: {LIMITS[name]}")
    return {name: _solver_option(name, text.strip()) for name, text in values.items()}


def _solver_option(name: str, text: str) -> str | int | float:
    if re.fullmatch(r"[-+]?[0-9]+", text, re.ASCII) and abs(int(text)) <= LARGEST_INTEGER:
        return int(text)
    try:
        number = float(text)
    except ValueError:
        return text
    if number != number:
        raise InputError(f"--solver-option {name} is {text}", "allowed: a number or a word")
    return number


def file_of_settings(context: click.Context, *last: str) -> Path:
    """File that is written without ``--output``, such as ``solo12-jump-distance=0.8-smallest.npz``.

    Its name has the settings of the command that change the motion, and ends with the words ``last``. Raises
    `InputError` where it is too long for a file.
    """
    words = [context.params["problem"]]
    for option in context.command.params:
        value = context.params.get(str(option.name))  # none of one without a value
        if option.name not in SAME_MOTION and value and value != option.get_default(context):
            words += _words(option, value)
    name = UNSAFE.sub("_", "-".join((*words, *last)).replace(" ", ""))
    if len(name) > LONGEST:
        raise InputError(f"the settings make a file name of {len(name)} characters", "allowed: --output FILE")
    return Path(f"{name}.npz")


def _words(option: click.Parameter, value: Any) -> list[str]:
    title = option.opts[0].removeprefix("--")
    if isinstance(value, tuple):
        return [each if option.name in NAMED else f"{title}={each}" for each in value]
    if value is True:
        return [title]
    return [f"{title}={value.with_suffix('') if isinstance(value, Path) and value.name else value}"]
