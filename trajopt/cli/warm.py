"""Options of ``trajopt solve`` to start from other solutions: a file, or coarser grids."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import option_group
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.solving.monitoring import Watch

LADDER_FORM = "allowed: SCHEME@INTERVALS,..., such as legendre:1@15,legendre:2@50"

warm_options = option_group(
    click.option("--start", type=Path, metavar="FILE", help="Solution file to start from."),
    click.option("--ladder", metavar="GRIDS", help="Coarse to fine, e.g. legendre:1@15,legendre:2@50."),
    click.option("--compare", is_flag=True, help="With either: solve from the default guess, too."),
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
    from trajopt.solution.input import solution_of
    from trajopt.solving.ladder import solve_ladder

    grid = (settings.pop("transcription"), settings.pop("intervals"))
    if ladder is not None and grid != (None, None):
        raise InputError(
            "--ladder is given with a grid of its own", "allowed: without --transcription, --intervals"
        )
    if compare and start is None and ladder is None:
        raise InputError("--compare has nothing to compare", "allowed: with --start or --ladder")
    rungs = [grid] if ladder is None else parse_ladder(ladder)
    known = None if start is None else solution_of(start)
    most = settings["max_time"] * (len(rungs) + compare)
    with watched(title, most, log, viewer) as told:
        found = solve_ladder(problem, rungs, start=known, compare=compare, **told, **settings)
    if len(found.rungs) == 1 and found.cold is None:
        return SolveReport(found.solution, found.solution.success)
    figures = found.to_dict()
    return SolveReport(found.solution, found.solution.success, _lines(figures), {"ladder": figures})


def parse_ladder(text: str) -> list[tuple[str | None, int | None]]:
    """Rungs of ``legendre:1@15,legendre:2@50``; raises `InputError` for another form."""
    rungs: list[tuple[str | None, int | None]] = []
    for rung in text.split(","):
        name, at, count = rung.strip().partition("@")
        if not (name and at and count.isascii() and count.isdigit()):
            raise InputError(f"rung '{rung}' of --ladder is not of that form", LADDER_FORM)
        rungs.append((name, int(count)))
    return rungs


def _lines(figures: dict[str, Any]) -> list[str]:
    """The summary of the rungs and of the comparison."""
    lines = [
        f"{rung['transcription']}, {rung['intervals']} intervals: {_found(rung)}" for rung in figures["rungs"]
    ]
    if len(figures["rungs"]) > 1:
        lines.append(f"all rungs: {cost(figures['total'])}")
    if figures["cold"] is not None:
        lines.append(f"from the default guess: {_found(figures['cold'])}")
    return lines


def _found(figures: dict[str, Any]) -> str:
    return f"{figures['status'].replace('_', ' ')}, {cost(figures)}"


def cost(figures: dict[str, Any]) -> str:
    """Return iterations and time of a solve, or of several, in words."""
    return f"{figures['iterations']} iterations, {figures['wall_time_s']:.2f} s"
