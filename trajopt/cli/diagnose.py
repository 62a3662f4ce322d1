"""``trajopt diagnose``: why a problem was not solved, or is hard to solve."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import chosen_problem, json_option
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError, TrajoptError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solution.solution import Solution


@click.command("diagnose")
@click.argument("file", type=Path)
@click.option("--problem", metavar="NAME", help="The problem of FILE.  [default: as named in FILE]")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of --problem.")
@json_option
def diagnose_command(file: Path, problem: str | None, settings: tuple[str, ...], as_json: bool) -> None:
    """Explain why FILE failed or is hard, and what to try.

    Reports rank and condition of the constraints by phase, linearly dependent constraints, curvature,
    scaling, active limits, the first value that is not finite, and constraints in conflict. Exit status 0
    whatever is found.
    """
    from trajopt.diagnosis.diagnose import diagnose

    if settings and problem is None:
        raise InputError("--set is given without a problem", "allowed: with --problem NAME")
    given = None if problem is None else chosen_problem(problem, settings)
    with busy(f"diagnosing {file}: ranks, curvature, conflicts"):
        diagnosis = diagnose(file, given)
    say(to_json(diagnosis.to_dict()) if as_json else str(diagnosis))


diagnose_option = click.option("--diagnose", "diagnosed", is_flag=True, help="Diagnose the result.")


def diagnosis_of(solution: Solution, problem: Problem) -> tuple[dict[str, Any], str]:
    """Diagnose the result of a solve, as JSON and as text; where that fails, the reason."""
    from trajopt.diagnosis.diagnose import diagnose

    try:
        diagnosis = diagnose(solution, problem)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return {"error": str(error)}, f"cannot be diagnosed: {error}"
    return diagnosis.to_dict(), str(diagnosis)
