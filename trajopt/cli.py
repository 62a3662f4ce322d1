"""The command line: a thin layer over the library.

Exit status: 0 done; 1 ran but not solved (``solve``) or not within tolerance (``check``); 2 bad
input, with one line on stderr; 130 cancelled by Ctrl-C. ``solve`` goes by the solver's verdict alone: a
solved problem whose motion a check finds beyond its tolerances is noted in the summary (and in
``accuracy`` of the JSON), and its exit status is 0, because a finer grid, not another solve, mends it.

Modules that take long to load are imported in the commands.
"""

from __future__ import annotations

import importlib
import sys
import threading
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt import cli_report
from trajopt.cli_aim import aim_options, solve_aimed, wants_aim
from trajopt.cli_check import check
from trajopt.cli_continue import continue_
from trajopt.cli_diagnose import diagnose, diagnose_option, diagnosis_of
from trajopt.cli_input import COUNT, GRID, THREADS, check_apart, check_output, options_of, values_of
from trajopt.cli_plot import plot
from trajopt.cli_reference import reference
from trajopt.cli_render import render
from trajopt.cli_replay import replay
from trajopt.cli_robot import robot
from trajopt.cli_simulate import simulate
from trajopt.cli_suite import suite
from trajopt.cli_sweep import sweep
from trajopt.cli_warm import solve_warm, warm_options
from trajopt.cli_watch import kept, opened, watch_options
from trajopt.errors import TrajoptError
from trajopt.progress import CANCELLED

if TYPE_CHECKING:
    from trajopt.certify.report import Report
    from trajopt.problem import Problem
    from trajopt.scenes import Scene
    from trajopt.solution import Solution

BAD_INPUT = 2
NOT_REACHED = 1
# Columns of a table that goes to a file or a pipe, which tells no width.
PIPE_WIDTH = 120


class CommandLine(click.Group):
    """A group that answers every bad input with one line on stderr and exit status 2."""

    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any
    ) -> None:
        """Run and leave with the exit status."""
        extra["standalone_mode"] = False
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of libraries, about their own future
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _show_warning
            sys.exit(self._status(args, prog_name or "trajopt", extra))

    def _status(self, args: Sequence[str] | None, prog_name: str, extra: dict[str, Any]) -> int:
        try:
            status = super().main(args, prog_name, **extra)
            return status if isinstance(status, int) else 0
        except click.UsageError as error:
            return _refuse(_usage(error))
        except click.ClickException as error:
            return _refuse(error.format_message())
        except TrajoptError as error:
            return _refuse(str(error))
        except OSError as error:
            return _refuse(f"{error.filename or 'input or output'}: {error.strerror or error}")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; an unknown one is refused with those that are known."""
        if args[0] not in self.commands:
            raise click.UsageError(
                f"no command '{args[0]}', allowed: {', '.join(sorted(self.commands))}", ctx
            )
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; Ctrl-C ends it with one line instead of click's empty one."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("trajopt: cancelled", err=True)
            return CANCELLED


def _refuse(message: str) -> int:
    click.echo(f"trajopt: {' '.join(message.split())}", err=True)
    return BAD_INPUT


def _usage(error: click.UsageError) -> str:
    where = error.ctx.command_path if error.ctx else "trajopt"
    return f"{error.format_message().rstrip('.')}; see '{where} --help'"


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"trajopt: warning: {' '.join(str(message).split())}", err=True)


@click.group(cls=CommandLine, no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="trajopt")
def main() -> None:
    """Trajectory optimisation for robots with contacts."""


main.add_command(simulate)
main.add_command(plot)
main.add_command(suite)
main.add_command(sweep)


@main.command("list")
@click.argument("problems", nargs=-1, metavar="[PROBLEM]...")
@click.option("--robot", metavar="NAME", help="Only problems that are tested on that robot.")
@click.option("--brief", is_flag=True, help="One row a problem: name, robots, summary.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def list_problems(problems: tuple[str, ...], robot: str | None, brief: bool, as_json: bool) -> None:
    """List problems with robots, phases and parameters: all, or those whose names fit, as in 'biped-*'."""
    from trajopt.catalogue import families
    from trajopt.suite.cases import select

    known = families()
    wanted = {case.problem for case in select(known, problems, [] if robot is None else [robot])}
    found = {name: family for name, family in known.items() if name in wanted}
    if as_json:
        click.echo(cli_report.to_json(cli_report.list_dict(found)))
        return
    console = cli_report.results_console(PIPE_WIDTH)
    if brief:
        console.print(cli_report.family_table(found))
        return
    for family in found.values():
        console.print(cli_report.family_heading(family), soft_wrap=True)
        console.print(cli_report.parameter_table(family))


@main.command()
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter, e.g. yaw=45deg.")
@click.option("--transcription", metavar="NAME", help="Scheme, e.g. legendre:2.  [default: the problem's]")
@click.option(
    "--intervals", type=GRID, metavar="N", help="Over the whole schedule.  [default: the problem's]"
)
@click.option("--solver", default="ipopt", metavar="NAME", show_default=True, help="ipopt, fatrop or sqp.")
@click.option(
    "--hessian",
    default="exact",
    metavar="NAME",
    show_default=True,
    help="exact, gauss-newton or limited-memory.",
)
@click.option(
    "--tol", "tolerance", type=float, default=1e-6, metavar="TOL", show_default=True, help="Tolerance."
)
@click.option("--seed", type=COUNT, default=0, metavar="K", show_default=True, help="Seed of --perturb.")
@click.option(
    "--perturb",
    type=float,
    default=0.0,
    metavar="SIGMA",
    show_default=True,
    help="Noise on the guess, scaled units.",
)
@click.option(
    "--max-iterations", type=COUNT, default=500, metavar="N", show_default=True, help="Iteration limit."
)
@click.option(
    "--max-time", type=float, default=600.0, metavar="S", show_default=True, help="Time limit in s."
)
@click.option("--compile", default="quick", metavar="LEVEL", show_default=True, help="none, quick or fast.")
@click.option("--threads", type=THREADS, default=1, metavar="N", show_default=True, help="For functions.")
@click.option(
    "--solver-option", "solver_options", multiple=True, metavar="NAME=VALUE", help="The solver's own option."
)
@click.option("--smallest", is_flag=True, help="Solve only what the scene requires, for the whole robot.")
@click.option("--explain", is_flag=True, help="The same; first say what is modelled, left out, and why.")
@click.option("--keep", multiple=True, metavar="JOINT", help="A joint that --smallest must not lock.")
@warm_options
@aim_options
@diagnose_option
@watch_options
@click.option("-o", "--output", type=Path, metavar="FILE", help="Solution file.  [default: PROBLEM.npz]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def solve(
    problem: str,
    settings: tuple[str, ...],
    solver_options: tuple[str, ...],
    smallest: bool,
    explain: bool,
    keep: tuple[str, ...],
    diagnosed: bool,
    watch: bool,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve PROBLEM and write the solution file.

    PROBLEM is solved as it is built. With --smallest or --explain joints that nothing needs are locked and a
    symmetric task is solved in the plane; the file holds the motion of the whole robot all the same.
    With --accuracy or --budget scheme, grid and solver are chosen from measured fronts, what is reached is
    measured, and the mesh is refined where it falls short of the accuracy.

    Exit status 0 when the solver has solved it, and to the accuracy or in the time that was asked for, 1 when
    not: the file then holds its last iterate, and
    its status and worst rows are printed. Ctrl-C stops the solver, keeps that iterate and ends with 1.
    """
    from trajopt.catalogue import families
    from trajopt.family import choose

    options = options_of(solver_options)
    loaded = choose(families(), problem).load(values_of(settings, "--set"))
    target = check_output(output or Path(f"{problem}.npz"))
    if arguments["log"] not in (None, "-"):  # the start may be replaced by its solution, not by a table
        start = arguments.get("start")
        check_apart([target, Path(arguments["log"])], [])
        check_apart([Path(arguments["log"])], [Path(start)] if start else [])
    scene = _scene(loaded, keep, arguments) if smallest or explain or keep else None
    if scene is not None and explain and not as_json:
        click.echo(str(scene.report))
    # The check's integrator takes long to load: let it load while the solver holds no Python lock.
    threading.Thread(target=importlib.import_module, args=("scipy.integrate",), daemon=True).start()
    solve_chosen = solve_aimed if wants_aim(arguments) else solve_warm
    viewer = opened(watch)
    arguments |= {"title": problem, "options": options, "viewer": viewer}
    found = solve_chosen(scene.problem if scene else loaded, **arguments)
    solution = scene.lift(found.solution) if scene else found.solution
    file, notes = _saved(solution, target)
    report = _checked(solution, notes, "" if scene is None or scene.report.is_exact else " or no --smallest")
    said = diagnosis_of(found.solution, scene.problem if scene else loaded) if diagnosed else None
    if as_json:
        explained: dict[str, Any] = {"scene": scene.report.to_dict()} if scene else {}
        explained |= {"diagnosis": said[0]} if said else {}
        explained |= found.extra()
        click.echo(cli_report.to_json(cli_report.solve_dict(solution, report, file) | explained))
    else:
        click.echo(cli_report.summary(solution, report, file, found.lines() + notes))
        if said:
            click.echo(said[1])
    kept(viewer, solution)
    return 0 if found.reached else NOT_REACHED


def _scene(problem: Problem, keep: tuple[str, ...], arguments: dict[str, Any]) -> Scene:
    """The smallest problem with the same task, on the grid that is asked for."""
    from trajopt.scenes import smallest

    grid = {name: arguments[name] for name in ("transcription", "intervals")}
    return smallest(problem, keep=keep, **grid)


def _saved(solution: Solution, target: Path) -> tuple[Path | None, list[str]]:
    """Write the solution; an iterate that is no motion (not finite) has no file, and a note says so."""
    from trajopt.errors import InputError
    from trajopt.solution_file import consistent_meta

    try:
        consistent_meta(solution)
    except InputError as error:
        return None, [f"no file: {error}"]
    return solution.save(target), []


def _checked(solution: Solution, notes: list[str], advice: str) -> Report | None:
    """The check of a solve, or None and a note where there is nothing that can be checked."""
    import numpy as np

    from trajopt.check import check

    try:
        with np.errstate(all="ignore"):  # an iterate that is no solution may overflow: its figures say so
            report = check(solution)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        notes.append(f"accuracy cannot be computed: {error}")
        return None
    beyond = cli_report.beyond(report)
    if beyond and solution.success:
        notes.append(f"beyond the tolerances of a check: {beyond}; try more intervals{advice}")
    return report


main.add_command(continue_)
main.add_command(diagnose)
main.add_command(check)
main.add_command(reference)
main.add_command(render)
main.add_command(replay)
main.add_command(robot)
