"""``trajopt solve --start`` and ``--ladder``: warm starts from a file, or from coarser meshes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import GRID, option_group, value_option
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solving.monitoring import Watch

LADDER_FORM = "allowed: SCHEME@INTERVALS,..., such as legendre:1@15,legendre:2@50"

warm_options = option_group(
    click.option("--start", type=Path, metavar="FILE", help="Solution file to start from."),
    value_option("--ladder", "GRIDS", "Coarse to fine meshes, e.g. legendre:1@15,legendre:2@50."),
    click.option("--compare", is_flag=True, help="Also solve from the default guess."),
)


def solve_warm(
    problem: Problem,
    *,
    start: Path | None,
    ladder: str | None,
    compare: bool,
    title: str,
    log: str | None = None,
    viewer: Watch | None = None,
    **settings: Any,
) -> SolveReport:
    """Solve from a file, over a ladder, or neither (a ladder of one rung), with progress."""
    from trajopt.motion.input import solution_of
    from trajopt.solving.ladder import solve_ladder
    from trajopt.solving.time_limits import OVERHEAD_TIME

    grid = (settings.pop("transcription"), settings.pop("intervals"))
    if ladder is not None and grid != (None, None):
        raise InputError(
            "--ladder and a single mesh are both given", "allowed: without --transcription, --intervals"
        )
    if compare and start is None and ladder is None:
        raise InputError("--compare has nothing to compare", "allowed: with --start or --ladder")
    rungs = [grid] if ladder is None else parse_ladder(ladder)
    known = start and solution_of(start)
    most = (settings["max_time"] + OVERHEAD_TIME) * (len(rungs) + compare)
    with watched(title, most, log, viewer) as callbacks:
        result = solve_ladder(problem, rungs, start=known, compare=compare, **callbacks, **settings)
    solution = result.solution
    if len(result.rungs) == 1 and result.cold is None:
        return SolveReport(solution, solution.success)
    figures = result.to_dict()
    return SolveReport(solution, solution.success, _lines(figures), {"ladder": figures})


def parse_ladder(text: str) -> list[tuple[str | None, int | None]]:
    """Rungs of ``legendre:1@15,legendre:2@50``; raises `InputError` for a wrong form."""
    rungs: list[tuple[str | None, int | None]] = []
    for rung in text.split(","):
        name, at, count = rung.strip().partition("@")
        if not (name and at and count.isascii() and count.isdigit() and int(count[:9]) <= GRID.most):
            raise InputError(f"rung '{rung}' of --ladder has the wrong form", LADDER_FORM)
        rungs.append((name, int(count)))
    return rungs


def _lines(figures: dict[str, Any]) -> list[str]:
    """Lines of the summary: the rungs, and the comparison."""
    grids = [f"{rung['transcription']}, {rung['intervals']} intervals" for rung in figures["rungs"]]
    lines = [f"{grid}: {_outcome(rung)}" for grid, rung in zip(grids, figures["rungs"], strict=True)]
    if len(figures["rungs"]) > 1:
        lines.append(f"all rungs: {cost(figures['total'])}")
    if figures["cold"] is not None:
        lines.append(f"from the default guess: {_outcome(figures['cold'])}")
    return lines


def _outcome(figures: dict[str, Any]) -> str:
    return f"{figures['status'].replace('_', ' ')}, {cost(figures)}"


def cost(figures: dict[str, Any]) -> str:
    """Return iterations and time of a solve, or of several, in words."""
    return f"{figures['iterations']} iterations, {figures['wall_time_s']:.2f} s"
