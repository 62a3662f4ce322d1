"""``trajopt continue``: a problem over a sequence of values of a parameter."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

from trajopt.cli_input import COUNT, GRID, THREADS, WholeNumber, check_output, options_of, values_of
from trajopt.cli_report import results_console, to_json
from trajopt.cli_warm import cost
from trajopt.cli_watch import kept, opened, watch_options
from trajopt.errors import InputError
from trajopt.progress import stdout_to_stderr, watched

if TYPE_CHECKING:
    from trajopt.continuation import Continuation, Step
    from trajopt.family import Family
    from trajopt.problem import Problem
    from trajopt.watching import Watch

NOT_REACHED = 1
MOST_VALUES = 1000
# Columns of a table that goes to a file or a pipe, which tells no width.
PIPE_WIDTH = 120
HALVINGS = WholeNumber(0, 20)
VARY_FORM = "allowed: NAME=START:STOP:COUNT, such as distance=0.2:0.4:5"


@click.command("continue")
@click.argument("problem")
@click.option("--vary", required=True, metavar="NAME=START:STOP:COUNT", help="The parameter and its values.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="Another parameter.")
@click.option("--compare", is_flag=True, help="Solve every value from its own guess, too.")
@click.option(
    "--max-halvings", type=HALVINGS, default=4, metavar="N", show_default=True, help="Of a step that fails."
)
@click.option("--start", type=Path, metavar="FILE", help="Solution file to start the first value from.")
@click.option(
    "--output-dir", type=Path, metavar="DIR", help="Folder for the solution files.  [default: none]"
)
@click.option("--transcription", metavar="NAME", help="Scheme.  [default: the problem's]")
@click.option("--intervals", type=GRID, metavar="N", help="Over the schedule.  [default: the problem's]")
@click.option("--solver", default="ipopt", metavar="NAME", show_default=True, help="ipopt, fatrop or sqp.")
@click.option("--tol", "tolerance", type=float, default=1e-6, metavar="TOL", show_default=True)
@click.option(
    "--max-iterations", type=COUNT, default=500, metavar="N", show_default=True, help="Of each solve."
)
@click.option("--max-time", type=float, default=600.0, metavar="S", show_default=True, help="Of each solve.")
@click.option("--compile", default="quick", metavar="LEVEL", show_default=True, help="none, quick or fast.")
@click.option("--threads", type=THREADS, default=1, metavar="N", show_default=True, help="For functions.")
@click.option(
    "--solver-option", "solver_options", multiple=True, metavar="NAME=VALUE", help="The solver's own."
)
@watch_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def continue_(
    problem: str,
    vary: str,
    settings: tuple[str, ...],
    start: Path | None,
    output_dir: Path | None,
    solver_options: tuple[str, ...],
    as_json: bool,
    watch: bool,
    log: str | None,
    **arguments: Any,
) -> int:
    """Solve PROBLEM for a sequence of values of a parameter, each from the last solution.

    A step that fails is halved. With --compare every value is solved from its own guess, too, and the time
    saved is shown. Exit status 0 when every value is solved, 1 when not.
    """
    from trajopt.catalogue import families
    from trajopt.family import choose
    from trajopt.warm_start import solution_of

    family, fixed = choose(families(), problem), values_of(settings, "--set")
    name, values = parse_vary(family, vary, fixed)
    load = _loader(family, name, fixed)
    load(values[0]), load(values[-1])  # refused before anything is solved
    folder = None if output_dir is None else _folder(output_dir, problem)
    known = None if start is None else solution_of(start)
    arguments |= {"options": options_of(solver_options), "start": known}
    threading.Thread(target=importlib.import_module, args=("scipy.integrate",), daemon=True).start()
    viewer = opened(watch)
    found = _continued(problem, load, values, arguments, log, viewer)
    files = {} if folder is None else _saved(found, folder, f"{problem}-{name}")
    if as_json:
        click.echo(to_json({"problem": problem, "parameter": name, "files": files, **found.to_dict()}))
    else:
        _print(found, problem, name, files)
    kept(viewer, found.steps[-1].solution)
    return 0 if found.success else NOT_REACHED


def parse_vary(family: Family, text: str, fixed: dict[str, str]) -> tuple[str, list[float]]:
    """Name and values of ``NAME=START:STOP:COUNT``; raises `InputError` for another form or name."""
    from trajopt.family import Parameter

    name, equals, spread = text.partition("=")
    name, parts = name.strip(), spread.split(":")
    count = parts[2] if len(parts) == 3 else ""
    if not (equals and count.isascii() and count.isdigit() and 2 <= int(count) <= MOST_VALUES):
        raise InputError(f"--vary '{text}' is not of that form", f"{VARY_FORM}, COUNT 2 to {MOST_VALUES}")
    numbers = [one.name for one in family.parameters if isinstance(one, Parameter)]
    parameter = next((one for one in family.parameters if one.name == name), None)
    if not isinstance(parameter, Parameter):
        raise InputError(f"{family.name} has no number '{name}' to vary", f"allowed: {', '.join(numbers)}")
    if name in fixed:
        raise InputError(f"'{name}' is both varied and set", "allowed: one of --vary and --set")
    first, last = (parameter.parse(part) for part in parts[:2])
    if first == last:
        raise InputError(f"--vary '{text}' starts where it ends", VARY_FORM)
    steps = int(count) - 1
    return name, [first + (last - first) * (i / steps) for i in range(steps)] + [last]


def _loader(family: Family, name: str, fixed: dict[str, str]) -> Callable[[float], Problem]:
    return lambda value: family.load({**fixed, name: value})


def _continued(
    title: str,
    load: Callable[[float], Problem],
    values: list[float],
    arguments: dict[str, Any],
    log: str | None,
    viewer: Watch | None,
) -> Continuation:
    from trajopt.continuation import continuation

    each = 2 + 2 * arguments["max_halvings"] + arguments["compare"]
    most = arguments["max_time"] * len(values) * each
    with stdout_to_stderr(), watched(title, most, log, viewer) as told:
        return continuation(load, values, **told, **arguments)


def _folder(path: Path, problem: str) -> Path:
    """The folder, made if it is not there; raises `InputError` where no solution can be written."""
    folder = path.expanduser()
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output-dir {folder} is no folder", "allowed: a folder, or a new one")
    folder.mkdir(parents=True, exist_ok=True)
    check_output(folder / f"{problem}.npz")
    return folder


def _saved(found: Continuation, folder: Path, stem: str) -> dict[str, str]:
    """Files of the values that were solved, by value."""
    return {
        f"{value:.9g}": str(solution.save(folder / f"{stem}={value:.9g}.npz"))
        for value, solution in found.solutions.items()
    }


def _print(found: Continuation, problem: str, name: str, files: dict[str, str]) -> None:
    console = results_console(PIPE_WIDTH)
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0))
    compared = any(step.cold is not None for step in found.steps)
    titles = (name, "from", "status", "iterations", "time s", "objective")
    for title in (*titles, *(("cold iterations", "cold time s") if compared else ())):
        table.add_column(title, justify="right", no_wrap=True)
    for step in found.steps:
        table.add_row(*_row(step, compared))
    console.print(f"{problem}: {len(found.solutions)} of {len(set(found.values))} values solved")
    console.print(table)
    totals = found.to_dict()
    console.print(f"in all {cost(totals['total'])}")
    if compared:
        saved = totals["saved"]
        console.print(
            f"from own guesses {cost(totals['cold'])}; saved {saved['iterations']} iterations, "
            f"{saved['wall_time_s']:.2f} s"
        )
    for file in files.values():
        console.print(file, soft_wrap=True)


def _row(step: Step, compared: bool) -> list[str]:
    meta = step.solution.meta
    begun = "own guess" if not meta["warm_start"] else "file" if step.origin is None else f"{step.origin:g}"
    objective = "" if meta["objective"] is None else f"{meta['objective']:.5g}"
    row = [f"{step.value:g}", begun, meta["status"].replace("_", " "), str(meta["iterations"])]
    row += [f"{meta['wall_time_s']:.2f}", objective]
    if compared:
        cold = None if step.cold is None else step.cold.meta
        row += ["", ""] if cold is None else [str(cold["iterations"]), f"{cold['wall_time_s']:.2f}"]
    return row
