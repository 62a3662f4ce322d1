"""``trajopt solve`` until the motion holds at any time; ``--draft`` and ``--fixed-mesh``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import option_group
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.motion.solution import Solution
    from trajopt.problem.problem import Problem
    from trajopt.solving.graded import Graded
    from trajopt.solving.monitoring import Watch
    from trajopt.transcription.mesh import Mesh

grade_options = option_group(
    click.option("--draft", is_flag=True, help="Solve on the first, coarse mesh only."),
    click.option("--fixed-mesh", is_flag=True, help="Solve on the problem's own mesh."),
    click.option("--gains", is_flag=True, help="Give the motion its feedback gains."),
)

# Settings that every solve for the same command shares.
SOLVER_SETTINGS = (
    "solver",
    "hessian",
    "tolerance",
    "max_iterations",
    "max_time",
    "threads",
    "options",
)


def wants_grade(arguments: dict[str, Any]) -> bool:
    """Whether the motion is examined and solved again, on a named mesh or refined ones; not on a ladder."""
    other = arguments["ladder"] is not None or arguments["compare"]
    if (other or _names_mesh(arguments)) and arguments["draft"]:
        raise InputError("--draft and a mesh are both given", "allowed: one of them")
    if other:
        del arguments["draft"], arguments["fixed_mesh"]
    return not other


def mesh_at_first(problem: Problem, arguments: dict[str, Any]) -> Mesh:
    """The mesh on which a solve with these arguments begins: the one that is named, or that of the grade."""
    from trajopt.solving.graded import first_mesh
    from trajopt.transcription.transcription import chosen_mesh

    if _names_mesh(arguments) or arguments["ladder"] is not None or arguments["compare"]:
        return chosen_mesh(problem, arguments["transcription"], arguments["intervals"])
    return first_mesh(problem, arguments["accuracy"] is not None)


def _names_mesh(arguments: dict[str, Any]) -> bool:
    grid = arguments["transcription"], arguments["intervals"]
    return bool(arguments.get("fixed_mesh")) or grid != (None, None)


def solve_to_grade(
    problem: Problem, *, title: str, log: str | None = None, viewer: Watch | None = None, **arguments: Any
) -> SolveReport:
    """Solve, examine and refine, with progress; a mesh that is named stays."""
    from trajopt.solving.graded import MOST_ROUNDS, solve_graded
    from trajopt.solving.time_limits import OVERHEAD_TIME
    from trajopt.transcription.transcription import chosen_mesh

    named = _names_mesh(arguments)
    for name in ("ladder", "compare", "fixed_mesh"):
        del arguments[name]
    grid = arguments.pop("transcription"), arguments.pop("intervals")
    mesh = chosen_mesh(problem, *grid) if named else None
    rounds = 1 if arguments.pop("draft") else MOST_ROUNDS
    with watched(title, arguments["max_time"] + OVERHEAD_TIME, log, viewer) as callbacks:
        result = solve_graded(
            problem, mesh=mesh, refine=not named, max_rounds=rounds, **callbacks, **arguments
        )
    extra = {"graded": result.to_dict()}
    return SolveReport(result.solution, result.reached, _lines(result), extra, result.examination)


def solve_whole(problem: Problem, lifted: Solution, arguments: dict[str, Any]) -> tuple[Solution, list[str]]:
    """The motion of a reduced model, solved once more from there for the whole robot if it misses the check.

    arguments: those of the command; a mesh that is named stays. Also returns lines of the summary.
    """
    from trajopt.certify.check import check
    from trajopt.motion.grid import mesh_of
    from trajopt.solving.graded import solve_graded
    from trajopt.solving.time_limits import OVERHEAD_TIME

    if not lifted.success or check(lifted, integrate=False).ok:
        return lifted, []
    settings = {key: arguments[key] for key in SOLVER_SETTINGS}
    refine = not _names_mesh(arguments)
    title = f"{arguments['title']}, whole robot"
    with watched(title, arguments["max_time"] + OVERHEAD_TIME, None, arguments["viewer"]) as callbacks:
        result = solve_graded(
            problem, mesh=mesh_of(lifted), start=lifted, refine=refine, **callbacks, **settings
        )
    iterations = sum(one.iterations for one in result.rounds)
    return result.solution, [f"whole robot: solved from the reduced motion, {iterations} iterations"]


def _lines(result: Graded) -> list[str]:
    """Lines of the summary: the meshes, and the grade."""
    lines = []
    for one in result.rounds if len(result.rounds) > 1 else ():
        size = f"{one.mesh.transcription} on {'+'.join(map(str, one.mesh.counts))}, {one.variables} variables"
        lines.append(f"{size}: {one.iterations} iterations, {one.wall_time:.2f} s")
    word = "at any time" if result.reached else "at its points" if result.solution.converged else "nowhere"
    lines.append(f"grade: holds {word}; {result.why}; {result.spent:.2f} s of the solver in all")
    return lines
