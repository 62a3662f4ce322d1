"""``trajopt bench``: many solves, timed and compared."""

import functools
from pathlib import Path
from typing import Any

import click

from trajopt.cli.commands import LazyGroup
from trajopt.cli.input import (
    NOT_REACHED,
    chosen_problem,
    default_option,
    file_of_settings,
    json_option,
    output_option,
    threads_option,
)
from trajopt.cli.report import say, to_json
from trajopt.motion.output import check_solution_output

COMMANDS = {
    "outside": "trajopt.cli.bench:outside",
    "reference": "trajopt.cli.bench:reference_command",
    "suite": "trajopt.cli.suite:suite",
    "sweep": "trajopt.cli.sweep:sweep",
}


@click.command(
    "bench",
    cls=LazyGroup,
    modules=COMMANDS,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
def bench() -> None:
    """Solve many problems or settings, timed and compared."""


@click.command("outside")
@json_option
def outside(as_json: bool) -> int:
    """Solve problems with published optima and compare.

    Exit status 1 when a value is not reached within its tolerance.
    """
    from rich.console import Console

    from trajopt.problem.catalogue import published_optima
    from trajopt.study.published import compared, comparison_table

    comparisons = list(compared(published_optima()))
    if as_json:
        say(to_json([one.to_dict() for one in comparisons]))
    else:
        Console(width=140).print(comparison_table(comparisons))
    return 0 if all(one.agrees for one in comparisons) else NOT_REACHED


@click.command("reference")
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter, e.g. yaw=45deg.")
@default_option("--transcription", "legendre:3", "NAME", "Scheme.", to="scheme")
@default_option("--solver", "ipopt", "NAME", "As for `solve`.")
@default_option("--tolerance", 1e-9, "TOL", "Tolerance.")
@default_option("--objective", 1e-5, "PART", "Agreement of objectives, relative.")
@default_option("--distance", 1e-3, "PART", "Agreement of motions, over the reach.")
@default_option("--max-time", 600.0, "S", "Time limit, s.")
@threads_option
@output_option("FILE", "Solution file.  [default: PROBLEM-SETTINGS-reference.npz]")
@json_option
def reference_command(
    problem: str,
    settings: tuple[str, ...],
    objective: float,
    distance: float,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve PROBLEM on finer meshes until two agree.

    The finest solution is written. Exit status 1 when no two agree within the time limit: the reason is
    printed and no file is written.
    """
    from trajopt.solving.reference import Agreement, NoReferenceError, converged_reference

    loaded = chosen_problem(problem, settings)
    target = check_solution_output(output or file_of_settings(click.get_current_context(), "reference"))
    bounds = Agreement(objective=objective, distance=distance)
    show = functools.partial(say, err=True)
    try:
        converged = converged_reference(loaded, agreement=bounds, progress=show, **arguments)
    except NoReferenceError as error:
        say(f"trajopt: {error}", err=True)
        return NOT_REACHED
    converged.solution.save(target)
    shown = {**converged.to_dict(), "file": str(target)}
    say(to_json(shown) if as_json else f"{converged}\n{target}")
    return 0
