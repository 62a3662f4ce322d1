"""``trajopt continue``: solve a problem for a sequence of values of a parameter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    NOT_REACHED,
    WholeNumber,
    default_option,
    file_of_settings,
    grid_options,
    json_option,
    options_of,
    parse_settings,
    solver_options,
    tolerance_option,
    value_option,
)
from trajopt.cli.interruption import CANCELLED, INTERRUPTION
from trajopt.cli.progress import open_viewer, show_until_interrupted, watch_options, watched
from trajopt.cli.report import console, plain_table, say, to_json
from trajopt.cli.warm import cost
from trajopt.errors import InputError, expanded
from trajopt.motion.output import check_apart, check_output

if TYPE_CHECKING:
    from trajopt.problem.family import Family
    from trajopt.problem.problem import Problem
    from trajopt.solving.continuation import Continuation, ContinuationStep

MOST_VALUES = 1000
HALVINGS = WholeNumber(0, 20)
VARY_FORM = "allowed: NAME=START:STOP:COUNT, such as distance=0.2:0.4:5"


@click.command("continue")
@click.argument("problem")
@click.option("--vary", required=True, metavar="NAME=START:STOP:COUNT", help="The parameter and its values.")
@click.option(
    "--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter that is not varied."
)
@click.option("--compare", is_flag=True, help="Also solve every value from its default guess.")
@default_option("--max-halvings", 4, "N", "How often a failed step is halved.", kind=HALVINGS)
@click.option("--start", type=Path, metavar="FILE", help="Solution file to start the first value from.")
@value_option("--output-dir", "DIR", "Folder for the solution files.  [default: none]", Path)
@grid_options
@tolerance_option
@solver_options
@watch_options
@json_option
def continue_command(
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
    """Solve PROBLEM for several values of a parameter in turn.

    Every value is solved from the last solution, until its motion holds at any time, on the mesh of the last
    one, refined where it misses; --transcription or --intervals name a mesh that stays. A step that fails is
    halved. With --compare every value is also solved from its default guess, and the time saved is printed.
    Exit status 0 when every value has a motion that holds, 1 when not, 130 after Ctrl-C.
    """
    from trajopt.motion.input import solution_of
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose
    from trajopt.solving.continuation import continuation
    from trajopt.solving.time_limits import OVERHEAD_TIME

    family, fixed = choose(families(), problem), parse_settings(settings, "--set")
    name, values = parse_vary(family, vary, fixed)

    def load(value: float) -> Problem:
        return family.load({**fixed, name: value})

    load(values[0]), load(values[-1])  # bad values are refused before solving
    if log not in (None, "-"):
        check_apart([Path(log)], [] if start is None else [start])
    context = click.get_current_context()
    targets = {value: file_of_settings(context, f"{name}={value:.9g}") for value in values}
    arguments |= {"options": options_of(solver_options), "start": start and solution_of(start)}
    folder = output_dir and _folder(output_dir, problem)
    viewer = open_viewer(watch)
    each = 2 + 2 * arguments["max_halvings"] + arguments["compare"]
    most = (arguments["max_time"] + OVERHEAD_TIME) * len(values) * each
    with watched(problem, most, log, viewer) as callbacks:
        result = continuation(load, values, **callbacks, **arguments)
    files = {}
    if folder is not None and result.solutions:
        folder.mkdir(parents=True, exist_ok=True)
        for value, solution in result.solutions.items():
            files[f"{value:.9g}"] = str(solution.save(folder / targets[value]))
    if as_json:
        say(to_json({"problem": problem, "parameter": name, "files": files, **result.to_dict()}))
    else:
        _print(result, problem, name, files)
    interrupted = INTERRUPTION.stops
    show_until_interrupted(viewer, result.steps[-1].solution)
    if interrupted and not result.success:
        say("trajopt: cancelled", err=True)
        return CANCELLED
    return 0 if result.success else NOT_REACHED


def parse_vary(family: Family, text: str, fixed: dict[str, str]) -> tuple[str, list[float]]:
    """Name and values of ``NAME=START:STOP:COUNT``; raises `InputError` for bad input."""
    from trajopt.problem.family import Parameter

    name, equals, spread = text.partition("=")
    name, parts = name.strip(), spread.split(":")
    count = parts[2] if len(parts) == 3 else ""
    if not (equals and count.isascii() and count.isdigit() and 2 <= int(count) <= MOST_VALUES):
        raise InputError(f"--vary '{text}' has the wrong form", f"{VARY_FORM}, COUNT 2 to {MOST_VALUES}")
    numbers = {each.name: each for each in family.parameters if isinstance(each, Parameter)}
    if name not in numbers:
        raise InputError(f"{family.name} has no number '{name}' to vary", f"allowed: {', '.join(numbers)}")
    if name in fixed:
        raise InputError(f"'{name}' is both varied and set", "allowed: one of --vary and --set")
    first, last = (numbers[name].parse(part) for part in parts[:2])
    if first == last:
        raise InputError(f"--vary '{text}' starts where it ends", VARY_FORM)
    steps = int(count) - 1
    return name, [first + (last - first) * (i / steps) for i in range(steps)] + [last]


def _folder(path: Path, problem: str) -> Path:
    """Return the folder, which may be new; raises `InputError` if no solution can be written there."""
    folder = expanded(path)
    known = next(place for place in (folder, *folder.parents) if place.exists())
    if not known.is_dir():
        raise InputError(f"--output-dir {known} is not a folder", "allowed: a folder, or a new one")
    check_output(known / f"{problem}.npz")
    return folder


def _print(result: Continuation, problem: str, name: str, files: dict[str, str]) -> None:
    shown = console()
    compared = any(step.cold is not None for step in result.steps)
    titles: tuple[str, ...] = (name, "from", "status", "iterations", "time s", "objective")
    titles += ("cold iterations", "cold time s") if compared else ()
    rows = [_row(step, compared) for step in result.steps]
    shown.print(f"{problem}: {len(result.solved)} of {len(set(result.values))} values solved")
    shown.print(plain_table(titles, rows, justify="right", no_wrap=True))
    totals = result.to_dict()
    shown.print(f"in all {cost(totals['total'])}")
    if compared:
        saved = totals["saved"]
        shown.print(
            f"from default guesses {cost(totals['cold'])}; saved {saved['iterations']} iterations, "
            f"{saved['wall_time_s']:.2f} s"
        )
    for file in files.values():
        shown.print(file, soft_wrap=True)


def _row(step: ContinuationStep, compared: bool) -> list[str]:
    from trajopt.solving.ladder import total_effort

    statistics, spent = step.solution.statistics, total_effort([step.solution])
    origin = "default guess" if not step.warm else "file" if step.origin is None else f"{step.origin:g}"
    objective = "" if statistics.objective is None else f"{statistics.objective:.5g}"
    row = [f"{step.value:g}", origin, statistics.status.replace("_", " "), str(spent["iterations"])]
    row += [f"{spent['wall_time_s']:.2f}", objective]
    if not compared:
        return row
    cold = step.cold and total_effort([step.cold])
    return [*row, str(cold["iterations"]), f"{cold['wall_time_s']:.2f}"] if cold else [*row, "", ""]
