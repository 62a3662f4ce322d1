"""Cost of pictures of a replay, and of watching a solve."""

import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import click
import numpy as np

from scripts.measure.shared import head, row, solver_option
from trajopt import Solution
from trajopt.solving.monitoring import Iterate, Watch
from trajopt.solving.solving import PreparedProblem, prepare, solve_prepared
from trajopt.view.replay.browser import chromium
from trajopt.view.replay.show import replay
from trajopt.view.watching.record import History, IterationTable
from trajopt.view.watching.viewer import Viewer
from trajopt_library import problems

SIZES = ((480, 270), (640, 360), (1280, 720), (1920, 1080))
RENDERER = """(() => {
    const gl = trajopt.viewer.renderer.getContext(), names = gl.getExtension("WEBGL_debug_renderer_info");
    return gl.getParameter(names.UNMASKED_RENDERER_WEBGL);
})()"""


@click.command()
@click.argument("file")
@click.option("--count", default=20, show_default=True, help="Pictures of each size.")
def pictures(file: str, count: int) -> None:
    """Wall and processor time in s for a picture of FILE's replay, by size."""
    head("size", "open s", "picture s", "processors s")
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        page = Path(folder, "page.html")
        replay(Solution.load(file), html=page)
        for size in SIZES:
            start = time.perf_counter()
            with browser.opened(page, size, "t=0&panel=off") as view:
                ready, busy = time.perf_counter(), processor_seconds()
                for t in np.linspace(view.start, view.start + view.duration, count):
                    view.seek(t)
                    view.png()
                each, used = time.perf_counter() - ready, processor_seconds() - busy
                renderer = view.evaluate(RENDERER)
            row(f"{size[0]}x{size[1]}", f"{ready - start:.2f}", f"{each / count:.3f}", f"{used / count:.3f}")
    click.echo(f"\ndrawn by {renderer}")


def processor_seconds() -> float:
    """Seconds that this process and all it has started have computed (Linux only)."""
    parents, used = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        number = int(path.parent.name)
        parents[number] = int(fields[1])
        used[number] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    total, mine = 0.0, {os.getpid()}
    while mine:
        total += sum(used[number] for number in mine)
        mine = {number for number, parent in parents.items() if parent in mine}
    return total


@click.command()
@click.argument("problem", default="solo12-jump")
@click.option("--repeat", default=5, show_default=True, help="Rounds of which medians are taken.")
@solver_option
def watching(problem: str, repeat: int, solver: str) -> None:
    """One solve alone, with a panel's history, with a log and with the viewer, in turn.

    The callback is the part of the solver's time that the watch spends in the solver's thread. Ends with an
    error if watching changes the iterations.
    """
    prepared = prepare(problems.load(problem))
    rounds = [{mode: watched(prepared, solver, mode) for mode in MODES} for _ in range(repeat)]
    counts = {found[0] for own in rounds for found in own.values()}
    if len(counts) > 1:
        raise click.ClickException(f"watching changed the iterations: {sorted(counts)}")
    click.echo(f"{problem}, {solver}, {counts.pop()} iterations, {prepared.guess.size} variables\n")
    head("mode", "s", "of alone", "callback ms", "of the solve", "iterates drawn")
    middle = {mode: np.median([own[mode][1:] for own in rounds], axis=0) for mode in MODES}
    for mode, (wall, spent, drawn) in middle.items():
        share = wall / middle["alone"][0]
        row(mode, f"{wall:.3f}", f"{share:.3f}", f"{1e3 * spent:.3f}", f"{spent / wall:.2%}", f"{drawn:.0f}")


MODES: dict[str, Callable[[Path, ExitStack], Watch | None]] = {
    "alone": lambda folder, stack: None,
    "panel": lambda folder, stack: History().add,
    "log": lambda folder, stack: stack.enter_context(IterationTable(folder / "log.csv")),
    "viewer": lambda folder, stack: stack.enter_context(Viewer()),
}


def watched(prepared: PreparedProblem, solver: str, mode: str) -> tuple[int, float, float, int]:
    """Iterations, the solver's seconds, seconds in the watch, and iterates drawn."""
    spent = 0.0
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        watch = MODES[mode](Path(folder), stack)

        def clocked(iterate: Iterate) -> None:
            nonlocal spent
            begin = time.perf_counter()
            watch(iterate)  # type: ignore[misc]
            if iterate.stage == "iteration":
                spent += time.perf_counter() - begin

        origin = {"seed": 0, "perturb": 0.0}
        found = solve_prepared(
            prepared, prepared.guess, origin=origin, solver=solver, watch=clocked if watch else None
        )
        drawn = 0
        if isinstance(watch, Viewer):
            watch.flush()
            drawn = watch.drawn
    return found.statistics.iterations, found.statistics.wall_time_s, spent, drawn
