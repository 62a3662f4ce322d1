"""``trajopt solve --accuracy`` and ``--budget``: the mesh is refined to an error, or within a time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import is_given, option_group
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solving.monitoring import Watch
    from trajopt.solving.rounds import Graded

# Options that follow from the target, and options without a meaning then.
CHOSEN = ("transcription", "intervals", "tolerance", "ladder", "compare")


class Quantity(click.ParamType):
    """A number above zero in SI units, or one with a unit of ``units``; ``such`` are examples."""

    def __init__(self, name: str, units: Mapping[str, float], such: str) -> None:
        self.name, self.units, self.such = name, units, such

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number in SI units."""
        text = str(value).strip()
        unit = max((unit for unit in self.units if text.endswith(unit)), key=len, default="")
        try:
            quantity = float(text.removesuffix(unit)) * self.units.get(unit, 1.0)
        except ValueError:
            quantity = None
        if quantity is None or not 0 < quantity < math.inf:
            self.fail(f"'{value}' is not a {self.name} above 0, allowed: such as {self.such}", param, ctx)
        return quantity


LENGTH = Quantity("length", {"mm": 1e-3, "cm": 1e-2, "m": 1.0}, "1e-3, 1mm or 0.1cm")
TIME = Quantity("time", {"ms": 1e-3, "s": 1.0, "min": 60.0}, "0.5s, 500ms or 2min")

aim_options = option_group(
    click.option(
        "--accuracy", type=LENGTH, metavar="M", help="Refine the mesh to this open-loop error, e.g. 1mm."
    ),
    click.option(
        "--budget",
        type=TIME,
        metavar="TIME",
        help="Refine the mesh within this time of the solver, e.g. 0.5s.",
    ),
)


def wants_aim(arguments: dict[str, Any]) -> bool:
    """Whether an accuracy or a time is asked for; removes both options otherwise."""
    wanted = arguments["accuracy"] is not None or arguments["budget"] is not None
    if not wanted:
        del arguments["accuracy"], arguments["budget"]
    return wanted


def solve_aimed(
    problem: Problem, *, title: str, log: str | None = None, viewer: Watch | None = None, **arguments: Any
) -> SolveReport:
    """Solve, measure and refine, with progress."""
    from trajopt.solving.graded import solve_graded, solve_within
    from trajopt.solving.time_limits import OVERHEAD_TIME

    accuracy, budget = arguments.pop("accuracy"), arguments.pop("budget")
    if accuracy is not None and budget is not None:
        raise InputError("--accuracy and --budget are both given", "allowed: one of them")
    for name in CHOSEN:
        if is_given(name):
            raise InputError(f"--{name} is given with --accuracy or --budget", "allowed: one of them")
        del arguments[name]
    with watched(title, arguments["max_time"] + OVERHEAD_TIME, log, viewer) as callbacks:
        settings = {**arguments, **callbacks}
        if accuracy is not None:
            result = solve_graded(problem, accuracy=accuracy, **settings)
            reached, target = result.reached, f"accuracy of {accuracy:g} m"
        else:
            del settings["max_time"]
            result = solve_within(problem, budget, **settings)
            reached, target = result.reached and result.spent <= budget, f"budget of {budget:g} s"
    lines = _lines(result, f"{target} {'reached' if reached else 'not reached'}")
    return SolveReport(result.solution, reached, lines, {"graded": result.to_dict()}, result.examination)


def _lines(result: Graded, verdict: str) -> list[str]:
    """Lines of the summary: rounds, and the target with what was reached."""
    lines = []
    for one in result.rounds:
        error = "" if one.error is None else f", error {one.error:.1e} m"
        lines.append(
            f"{one.mesh.transcription} on {'+'.join(map(str, one.mesh.counts))}: "
            f"{one.status.replace('_', ' ')}, {one.variables} variables, "
            f"{one.iterations} iterations, {one.wall_time:.2f} s{error}"
        )
    return [*lines, f"{verdict}: {result.error:.1e} m in {result.spent:.2f} s; {result.why}"]
