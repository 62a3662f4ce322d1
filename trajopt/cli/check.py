"""``trajopt check`` and ``trajopt diagnose``: does the motion in a file hold, and why was it not solved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import NOT_REACHED, chosen_problem, json_option, value_option
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError, TrajoptError

if TYPE_CHECKING:
    from trajopt.motion.solution import Solution
    from trajopt.problem.problem import Problem


@click.command("check")
@click.argument("file", type=Path)
@click.option("--accuracy", is_flag=True, help="Also report open-loop and local errors.")
@value_option("--reference", "FILE", "As --accuracy, and compare with this converged solution.", Path)
@json_option
def check_command(file: Path, accuracy: bool, reference: Path | None, as_json: bool) -> int:
    """Recompute the figures of FILE with numeric Pinocchio alone.

    --accuracy adds the open-loop error of the planned torques over intervals, phases and the whole motion,
    and the residuals of dynamics and constraints between collocation points. Exit status 1 when a figure is
    beyond its tolerance; the figures of --accuracy have no tolerance.
    """
    from trajopt.certify.check import check
    from trajopt.motion.solution import Solution

    plan = Solution.load(file)
    with busy(f"checking {file}"):
        report = check(plan)
    shown, text = report.to_dict(), report.table()
    if accuracy or reference is not None:
        from trajopt.certify.accuracy.measures import measure

        with busy(f"integrating the torques of {file}"):
            accuracy_figures = measure(plan, reference)
        shown["accuracy"] = accuracy_figures.to_dict()
        text = f"{text}\n\n{accuracy_figures.table()}"
    say(to_json(shown) if as_json else f"{text}\n{report.verdict()}")
    return 0 if report.ok else NOT_REACHED


@click.command("diagnose")
@click.argument("file", type=Path)
@click.option("--problem", metavar="NAME", help="The problem of FILE.  [default: as named in FILE]")
@click.option("--robot", metavar="NAME", help="Its robot, or a .py file.  [default: the robot named in FILE]")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of --problem.")
@json_option
def diagnose_command(
    file: Path, problem: str | None, robot: str | None, settings: tuple[str, ...], as_json: bool
) -> None:
    """Explain why FILE failed or is hard, and what to try.

    Reports rank and condition of the constraints by phase, linearly dependent constraints, curvature,
    scaling, active limits, the first value that is not finite, and constraints in conflict. Exit status 0
    whatever is found.
    """
    from trajopt.solving.diagnosis.diagnose import diagnose

    if settings and problem is None:
        raise InputError("--set is given without a problem", "allowed: with --problem NAME")
    if robot is not None and problem is not None:
        raise InputError("--robot is given with --problem", "allowed: --problem NAME --set robot=NAME")
    given = None if problem is None else chosen_problem(problem, settings)
    with busy(f"diagnosing {file}: ranks, curvature, conflicts"):
        diagnosis = diagnose(file, given, robot=robot)
    say(to_json(diagnosis.to_dict()) if as_json else str(diagnosis))


diagnose_option = click.option("--diagnose", "diagnosed", is_flag=True, help="Diagnose the result.")


def diagnosis_of(solution: Solution, problem: Problem) -> tuple[dict[str, Any], str]:
    """Diagnose the result of a solve, as JSON and as text; where that fails, the reason."""
    from trajopt.solving.diagnosis.diagnose import diagnose

    try:
        diagnosis = diagnose(solution, problem)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return {"error": str(error)}, f"cannot be diagnosed: {error}"
    return diagnosis.to_dict(), str(diagnosis)
