"""Input of the command line: numbers, NAME=VALUE settings, options that several commands share."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click
from typing_extensions import override

from trajopt.errors import InputError
from trajopt.solvers.drivers import SOLVERS

if TYPE_CHECKING:
    from pathlib import Path

    from trajopt.problem.problem import Problem
    from trajopt.solution.solution import Solution

_Command = TypeVar("_Command", bound=Callable[..., Any])
_INTEGER = re.compile(r"[-+]?[0-9]+", re.ASCII)
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


def default_option(
    name: str,
    default: Any,
    metavar: str,
    help: str,
    *,
    to: str | None = None,
    kind: click.ParamType | None = None,
    **settings: Any,
) -> Callable[[_Command], _Command]:
    """Return an option with a default that its help shows; ``to`` names the command's argument."""
    names, settings = (name,) if to is None else (name, to), {"show_default": True, **settings}
    return click.option(*names, default=default, type=kind, metavar=metavar, help=help, **settings)


def is_given(name: str) -> bool:
    """Whether the option of that name is on the command line that runs."""
    source = click.get_current_context().get_parameter_source(name)
    return source is click.core.ParameterSource.COMMANDLINE


def option_group(*options: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
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
    click.option(
        "--transcription", metavar="NAME", help="Scheme, e.g. legendre:2.  [default: the problem's]"
    ),
    click.option(
        "--intervals", type=GRID, metavar="N", help="Number of intervals in all.  [default: the problem's]"
    ),
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


controller_option = click.option(
    "--controller",
    type=click.Choice(["joints", "whole-body"]),
    default="joints",
    show_default=True,
    help="Feedback of single joints, or of the whole body.",
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
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose

    return choose(families(), name).load(parse_settings(settings, "--set"))


def load_plan(file: Path) -> Solution:
    """The solution in a file; warns where it is not a success."""
    from trajopt.solution.solution import Solution

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
    return {name: _option(name, text.strip()) for name, text in values.items()}


def _option(name: str, text: str) -> str | int | float:
    if _INTEGER.fullmatch(text) and abs(int(text)) <= LARGEST_INTEGER:
        return int(text)
    try:
        number = float(text)
    except ValueError:
        return text
    if number != number:
        raise InputError(f"--solver-option {name} is {text}", "allowed: a number or a word")
    return number
