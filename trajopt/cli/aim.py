"""``trajopt solve --accuracy`` and ``--budget``: settings are chosen from measured fronts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import is_given, option_group
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solving.monitoring import Watch
    from trajopt.study.choosing.solve_to import TargetSolve

# Options that are chosen, and options without a meaning then.
CHOSEN = ("transcription", "intervals", "tolerance")
WITHOUT = ("ladder", "compare")


class Quantity(click.ParamType):
    """A number above zero in SI units, or one with a unit of ``units``; ``such`` are examples."""

    def __init__(self, name: str, units: Mapping[str, float], such: str) -> None:
        self.name, self.units, self.such = name, units, such

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number in SI units."""
        text = str(value).strip()
        unit = max((unit for unit in self.units if text.endswith(unit)), key=len, default="")
        try:
            found = float(text.removesuffix(unit)) * self.units.get(unit, 1.0)
        except ValueError:
            found = None
        if found is None or not 0 < found < math.inf:
            self.fail(f"'{value}' is not a {self.name} above 0, allowed: such as {self.such}", param, ctx)
        return found


LENGTH = Quantity("length", {"mm": 1e-3, "cm": 1e-2, "m": 1.0}, "1e-3, 1mm or 0.1cm")
TIME = Quantity("time", {"ms": 1e-3, "s": 1.0, "min": 60.0}, "0.5s, 500ms or 2min")

aim_options = option_group(
    click.option(
        "--accuracy", type=LENGTH, metavar="M", help="Choose settings for this open-loop error, e.g. 1mm."
    ),
    click.option("--budget", type=TIME, metavar="TIME", help="Choose settings for this time, e.g. 0.5s."),
    click.option(
        "--front", metavar="FRONT", help="Measured front to choose from.  [default: the most similar]"
    ),
)


def wants_aim(arguments: dict[str, Any]) -> bool:
    """Whether settings are chosen automatically; refuses ``--front`` alone."""
    if arguments["accuracy"] is None and arguments["budget"] is None:
        if arguments["front"] is not None:
            raise InputError("--front has no effect here", "allowed: with --accuracy or --budget")
        for name in ("accuracy", "budget", "front"):
            del arguments[name]
        return False
    return True


def solve_aimed(
    problem: Problem, *, title: str, log: str | None = None, viewer: Watch | None = None, **arguments: Any
) -> SolveReport:
    """Choose, solve, measure and refine, with progress."""
    from trajopt.solving.time_limits import BESIDE
    from trajopt.study.choosing.solve_to import solve_to_accuracy, solve_within

    accuracy, budget, front = (arguments.pop(name) for name in ("accuracy", "budget", "front"))
    if accuracy is not None and budget is not None:
        raise InputError("--accuracy and --budget are both given", "allowed: one of them")
    where = _allowed_settings(arguments)
    most = arguments["max_time"] + BESIDE
    with watched(title, most, log, viewer) as callbacks:
        settings = {**arguments, "front": front, "where": where, **callbacks}
        if accuracy is not None:
            found = solve_to_accuracy(problem, accuracy, **settings)
        else:
            found = solve_within(problem, budget, **settings)
    return SolveReport(found.solution, found.reached, _lines(found), {"aimed": found.to_dict()})


def _allowed_settings(arguments: dict[str, Any]) -> Callable[[Any], bool]:
    """Filter for the named solver and Hessian; removes options that are chosen from ``arguments``."""
    for name in (*CHOSEN, *WITHOUT):
        if is_given(name):
            raise InputError(f"--{name} is given with --accuracy or --budget", "allowed: one of them")
        del arguments[name]
    fixed = {name: arguments.pop(name) for name in ("solver", "hessian")}
    wanted = {name: value for name, value in fixed.items() if is_given(name)}
    return lambda setting: all(getattr(setting, name) == value for name, value in wanted.items())


def _lines(found: TargetSolve) -> list[str]:
    """Lines of the summary: chosen settings, rounds, result."""
    lines = []
    for choice in found.choices:
        mesh, setting = choice.mesh, choice.measured.setting
        lines.append(
            f"chosen from {choice.front}: {mesh.transcription}, {sum(mesh.counts)} intervals, "
            f"{setting.solver}, {setting.hessian}; "
            f"predicted {choice.predicted_error:.1e} m, {choice.predicted_time:.2g} s"
        )
    for solve in found.rounds:
        error = "" if solve.error is None else f", error {solve.error:.1e} m"
        lines.append(
            f"{solve.mesh.transcription} on {'+'.join(map(str, solve.mesh.counts))}: "
            f"{solve.status.replace('_', ' ')}, {solve.variables} variables, "
            f"{solve.iterations} iterations, {solve.wall_time:.2f} s{error}"
        )
    unit = "m" if found.goal == "accuracy" else "s"
    verdict = "reached" if found.reached else "not reached"
    lines.append(
        f"{found.goal} of {found.wanted:g} {unit} {verdict}: "
        f"{found.error:.1e} m in {found.spent:.2f} s; {found.why}"
    )
    return lines
