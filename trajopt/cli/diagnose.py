"""``trajopt diagnose``: why a problem is hard, or was not solved, in words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from trajopt.cli.input import values_of
from trajopt.cli.report import to_json
from trajopt.errors import InputError, TrajoptError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solution.solution import Solution

Command = TypeVar("Command", bound=Callable[..., Any])


@click.command("diagnose")
@click.argument("file", type=Path)
@click.option("--problem", metavar="NAME", help="The problem of FILE.  [default: the one that it names]")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of --problem.")
@click.option(
    "--compile", metavar="LEVEL", help="none, quick or fast.  [default: as FILE was solved if that is cached]"
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def diagnose(
    file: Path, problem: str | None, settings: tuple[str, ...], compile: str | None, as_json: bool
) -> None:
    """Say what stands in the way of FILE's problem at its iterate, solved or not, and what to try.

    Ranks and conditions of the constraints by phase with the rows that depend on each other, curvature,
    scaling, active limits, the first value that is not finite, and which rows contradict each other. Exit
    status 0 whatever is found.
    """
    from trajopt.study.diagnosis.diagnose import diagnose as run

    if settings and problem is None:
        raise InputError("--set is given without a problem", "allowed: with --problem NAME")
    found = run(file, None if problem is None else _load(problem, settings), compile=compile)
    click.echo(to_json(found.to_dict()) if as_json else str(found))


def _load(problem: str, settings: tuple[str, ...]) -> Problem:
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose

    return choose(families(), problem).load(values_of(settings, "--set"))


def diagnose_option(command: Command) -> Command:
    """The option ``--diagnose`` of a solve."""
    return click.option("--diagnose", "diagnosed", is_flag=True, help="Say what is wrong, if anything.")(
        command
    )


def diagnosis_of(solution: Solution, problem: Problem) -> tuple[dict[str, Any], str]:
    """A diagnosis of what a solve has found, as JSON and as text; where there is none, the reason."""
    from trajopt.study.diagnosis.diagnose import diagnose as run

    try:
        found = run(solution, problem)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return {"error": str(error)}, f"cannot be diagnosed: {error}"
    return found.to_dict(), str(found)
