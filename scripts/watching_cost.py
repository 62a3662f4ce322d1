"""What seeing a solve costs: the same solve alone, with a panel's history, a log, and the viewer.

uv run python -m scripts.watching_cost solo12-jump --repeat 5

Modes take turns, so that a change of the machine's speed meets all of them. Times are the medians of the
solver's own wall time; ``callback`` is the part of it that the watch spent in the solver's thread. Watching
never changes the iterations: the script ends with an error if it did.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from trajopt.solving.monitoring import Iterate, Watch
from trajopt.solving.solving import DEFAULT_SOLVER, PreparedProblem, prepare, solve_prepared
from trajopt.view.watching.history import History
from trajopt.view.watching.record import Table
from trajopt.view.watching.viewer import Viewer
from trajopt_library import problems

MODES = ("alone", "panel", "log", "viewer")


class Clocked:
    """A watch and the seconds that it takes where it is called."""

    def __init__(self, watch: Watch) -> None:
        self.watch, self.spent = watch, 0.0

    def __call__(self, iterate: Iterate) -> None:
        begin = time.perf_counter()
        self.watch(iterate)
        if iterate.stage == "iteration":
            self.spent += time.perf_counter() - begin


def opened(mode: str, folder: Path, stack: ExitStack) -> Watch | None:
    """The watch of a mode."""
    makers: dict[str, Callable[[], Watch | None]] = {
        "alone": lambda: None,
        "panel": lambda: History().add,
        "log": lambda: stack.enter_context(Table(folder / "log.csv")),
        "viewer": lambda: stack.enter_context(Viewer()),
    }
    return makers[mode]()


def measured(prepared: PreparedProblem, solver: str, mode: str) -> tuple[int, float, float, int]:
    """Iterations, the solver's seconds, seconds in the watch, and iterates drawn."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        watch = opened(mode, Path(folder), stack)
        clocked = None if watch is None else Clocked(watch)
        origin = {"seed": 0, "perturb": 0.0}
        found = solve_prepared(prepared, prepared.guess, origin=origin, solver=solver, watch=clocked)
        drawn = 0
        if isinstance(watch, Viewer):
            watch.flush()
            drawn = watch.drawn
        spent = 0.0 if clocked is None else clocked.spent
        return found.meta["iterations"], found.meta["wall_time_s"], spent, drawn


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problem", nargs="?", default="solo12-jump")
    parser.add_argument("--solver", default=DEFAULT_SOLVER)
    parser.add_argument("--compile", default="quick")
    parser.add_argument("--intervals", type=int)
    parser.add_argument("--repeat", type=int, default=5)
    given = parser.parse_args()
    problem = problems.load(given.problem)
    prepared = prepare(problem, compile=given.compile, intervals=given.intervals)
    rounds = [{mode: measured(prepared, given.solver, mode) for mode in MODES} for _ in range(given.repeat)]
    counts = {found[0] for own in rounds for found in own.values()}
    assert len(counts) == 1, f"watching changed the iterations: {counts}"
    alone = statistics.median(own["alone"][1] for own in rounds)
    print(f"{given.problem}, {given.solver}, {counts.pop()} iterations, {prepared.guess.size} unknowns")
    for mode in MODES:
        wall = statistics.median(own[mode][1] for own in rounds)
        spent = statistics.median(own[mode][2] for own in rounds)
        drawn = statistics.median(own[mode][3] for own in rounds)
        print(
            f"{mode:8} {wall:7.3f} s, {wall / alone:6.3f} of alone; callback {1e3 * spent:7.3f} ms, "
            f"{spent / wall:.2%} of the solve; {drawn:.0f} iterates drawn"
        )


if __name__ == "__main__":
    main()
