"""``trajopt solve``: solve a problem of the catalogue and write a solution file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.aim import aim_options, solve_aimed, wants_aim
from trajopt.cli.check import diagnose_option, diagnosis_of
from trajopt.cli.commands import GroupedCommand
from trajopt.cli.grade import grade_options, mesh_at_first, solve_to_grade, solve_whole, wants_grade
from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    chosen_problem,
    default_option,
    file_of_settings,
    grid_options,
    is_given,
    json_option,
    options_of,
    output_option,
    solver_options,
    tolerance_option,
)
from trajopt.cli.nearest import Search, nearest_option, wants_other_way
from trajopt.cli.progress import open_viewer, show_until_interrupted, watch_options
from trajopt.cli.report import say, solve_dict, solve_summary, to_json
from trajopt.cli.warm import solve_warm, warm_options
from trajopt.errors import InputError, TrajoptError
from trajopt.motion.output import check_apart, check_solution_output

if TYPE_CHECKING:
    from collections.abc import Callable

    from trajopt.certify.check import Examination
    from trajopt.certify.report import CheckReport
    from trajopt.cli.report import SolveReport
    from trajopt.motion.solution import Solution
    from trajopt.reduced.scenes.smallest_scene import SmallestScene


@click.command(
    "solve",
    cls=GroupedCommand,
    groups={
        "Problem": "settings smallest explain keep nearest",
        "Accuracy and mesh": "draft fixed_mesh transcription intervals accuracy budget",
        "Start": "start ladder compare seed perturb",
        "Solver": "solver hessian tolerance max_iterations max_time threads solver_options",
        "Watching": "watch log diagnosed",
        "Output": "gains output as_json",
    },
)
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter, e.g. yaw=45deg.")
@grid_options
@default_option("--hessian", "exact", "NAME", "exact, gauss-newton or limited-memory.")
@tolerance_option
@default_option("--seed", 0, "K", "Seed of --perturb.", kind=COUNT)
@default_option("--perturb", 0.0, "SIGMA", "Noise on the guess, in scaled units.")
@solver_options
@click.option("--smallest", is_flag=True, help="Solve the smallest model that the task requires.")
@click.option("--explain", is_flag=True, help="Print what --smallest models, leaves out, and why.")
@click.option("--keep", multiple=True, metavar="JOINT", help="A joint that --smallest must not lock.")
@warm_options
@aim_options
@grade_options
@nearest_option
@diagnose_option
@watch_options
@output_option("FILE", "Solution file.  [default: PROBLEM-SETTINGS.npz]")
@json_option
def solve_command(
    problem: str,
    settings: tuple[str, ...],
    solver_options: tuple[str, ...],
    smallest: bool,
    explain: bool,
    keep: tuple[str, ...],
    nearest: str | None,
    diagnosed: bool,
    watch: bool,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Solve PROBLEM and write the solution file.

    By default PROBLEM is solved as built. With --smallest, joints that the task does not need are locked and
    a symmetric task is solved for half of the robot; the file holds the whole robot's motion. --explain
    prints what is modelled then, and changes nothing.

    The motion is examined at any time, and the mesh refined where it misses the tolerances of trajopt check;
    --draft takes the first mesh, --fixed-mesh the problem's own, --transcription or --intervals another.
    With --accuracy the open-loop error is measured, too, and the mesh refined until it is small enough; with
    --budget it is refined for as long as another round is expected to fit into that time of the solver.

    Where a value of --set is not solved, --nearest PARAMETER searches the nearest one that is, from the
    default by bisection, in at most 8 solves to the grade. Its motion is written to a file of its own, named
    for its value.

    Without --output the file is named for PROBLEM and the settings given, such as
    solo12-jump-distance=0.8.npz: other settings do not overwrite it.

    Exit status 0 when the motion holds, with --accuracy or --budget within that target, 1 when not: the
    file then holds the best motion or the last iterate, and what is missed most is printed. Ctrl-C stops the
    solver, keeps the last iterate and ends with 1.
    """
    options = options_of(solver_options)
    if is_given("seed") and not arguments["perturb"]:
        raise InputError("--seed has no effect here", "allowed: with --perturb SIGMA")
    loaded = chosen_problem(problem, settings)
    target = check_solution_output(output or file_of_settings(click.get_current_context()))
    if arguments["log"] not in (None, "-"):  # the solution may overwrite the start file, the table may not
        start, log = arguments.get("start"), Path(arguments["log"])
        check_apart([target, log], [])
        check_apart([log], [Path(start)] if start else [])
    search = None if nearest is None else Search.of(problem, settings, nearest, target)
    if search and (smallest or keep or wants_other_way(arguments)):
        raise InputError(
            "--nearest is given with another way of solving",
            "allowed: without --smallest, --keep, --ladder, --compare, --accuracy and --budget",
        )
    if arguments["gains"] and (smallest or keep):
        raise InputError("--gains of the smallest model", "allowed: without --smallest and --keep")
    scene: SmallestScene | None = None
    if smallest or explain or keep:
        from trajopt.reduced.scenes.smallest_scene import smallest as smallest_scene

        scene = smallest_scene(loaded, keep=keep, mesh=mesh_at_first(loaded, arguments))
        if explain and not as_json:
            say(str(scene.report))
    extra: dict[str, Any] = {"scene": scene.report.to_dict()} if scene and as_json else {}
    if not (smallest or keep):
        scene = None  # only explained
    asked = scene.problem if scene else loaded
    solve_chosen = _way_of_solving(arguments)
    viewer = open_viewer(watch)
    arguments |= {"title": problem, "options": options, "viewer": viewer}
    solved = solve_chosen(asked, **arguments)
    if search and not solved.reached:
        solved = search.run(solved, arguments)
    solution = solved.solution
    whole: list[str] = []
    if scene:
        solution, whole = solve_whole(loaded, scene.lift(solution), arguments)
    file, notes = _saved(solution, target)
    report = _checked(solution, notes, None if scene else solved.examination)
    diagnosis = diagnosis_of(solved.solution, asked) if diagnosed else None
    if as_json:
        extra |= {"diagnosis": diagnosis[0]} if diagnosis else {}
        say(to_json(solve_dict(solution, report, file) | extra | solved.extra))
    else:
        say(solve_summary(solution, report, file, solved.notes + whole + notes))
        if diagnosis:
            say(diagnosis[1])
    show_until_interrupted(viewer, solution)
    return 0 if solved.reached and (solution.success or not scene) else NOT_REACHED


def _way_of_solving(arguments: dict[str, Any]) -> Callable[..., SolveReport]:
    """The function that solves as the options ask; removes those that it does not take."""
    if wants_aim(arguments):
        for name in ("draft", "fixed_mesh"):
            if arguments.pop(name):
                raise InputError(
                    f"--{name.replace('_', '-')} has no effect here", "allowed: without --accuracy"
                )
        return solve_aimed
    return solve_to_grade if wants_grade(arguments) else solve_warm


def _saved(solution: Solution, target: Path) -> tuple[Path | None, list[str]]:
    """Write the solution; an iterate that is not finite is not written, and a note says so."""
    try:
        solution.require_consistent()
    except InputError as error:
        return None, [f"no file: {error}"]
    return solution.save(target), []


def _checked(solution: Solution, notes: list[str], known: Examination | None) -> CheckReport | None:
    """The check of a solve, from what is ``known`` of it, or None and a note if it cannot be checked."""
    import numpy as np

    from trajopt.certify.check import check
    from trajopt.certify.report import FIGURES

    try:
        with np.errstate(all="ignore"):  # an iterate of a failed solve may overflow; its figures show that
            report = known.integrated() if known else check(solution)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        notes.append(f"accuracy cannot be computed: {error}")
        return None
    bodies = solution.description.bodies
    notes += [] if bodies is None else bodies.doubts(solution.model)
    beyond = ", ".join(FIGURES[name].text for name in report.failures())
    if beyond and solution.success:
        notes.append(f"beyond the tolerances of a check: {beyond}; try more intervals")
    return report
