"""What is seen of a solve in a terminal and in a log, and how a solve that does not return ends."""

import csv
import math
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len

from tests.support.problems import hop
from tests.support.processes import AtTerminal, python
from tests.support.refusals import refused
from trajopt import Problem, solve, solve_ladder
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.monitoring import Iterate, combine_watches
from trajopt.view.watching.panel import ASCII, BLOCKS, MISSING, panel_lines, sparkline
from trajopt.view.watching.record import COLUMNS, FIGURES, History, IterationLines, IterationTable

pytestmark = pytest.mark.long

STUCK = """
import time
from trajopt.cli import progress
progress.GRACE = 0.1
with progress.watched("stuck", 0.1) as told:
    told["progress"]({"iteration": 0})
    time.sleep(30.0)
"""

RETURNING = STUCK.replace("time.sleep(30.0)", "pass") + "\ntime.sleep(0.5)\nprint('done')"


def test_a_solver_beyond_its_time_limit_ends_the_program_in_one_line():
    done = python(STUCK)
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert "time limit of 0.1 s" in line


def test_a_solver_that_returns_is_left_alone():
    done = python(RETURNING)
    assert done.returncode == 0
    assert done.stdout.strip() == "done"


def small() -> Problem:
    return hop()


def seen_by(watch: Callable[[Iterate], None], **settings: object) -> None:
    solve(small(), transcription="legendre:1", watch=watch, **settings)


def test_one_block_is_a_decade_of_eight():
    assert sparkline([10.0**-k for k in range(8)], 8) == BLOCKS[::-1]


def test_more_values_than_columns_show_the_largest_of_each_run():
    assert sparkline([1.0, 1e-7, 1e-7, 1e-7], 2) == BLOCKS[-1] + BLOCKS[0]
    assert len(sparkline([1.0] * 1000, 40)) == 40


def test_fewer_values_than_columns_take_a_column_each():
    assert len(sparkline([3.0, 2.0, 1.0], 40)) == 3


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_what_has_no_logarithm_is_marked(value: float):
    assert sparkline([1.0, value], 10)[1] == MISSING


def test_zero_is_the_lowest_and_a_flat_series_is_flat():
    assert sparkline([1.0, 0.0], 10) == BLOCKS[-1] + BLOCKS[0]
    assert len(set(sparkline([2.0, 2.0, 2.0], 10))) == 1
    assert len(set(sparkline([-5.0, -5.0], 10, linear=True))) == 1
    assert sparkline([0.0], 10, linear=True) == BLOCKS[0]


def test_a_linear_line_shows_negative_values_in_order():
    assert sparkline([-1.0, 0.0, 1.0], 10, linear=True)[::2] == BLOCKS[0] + BLOCKS[-1]


def test_nothing_is_shown_without_values_or_columns():
    assert sparkline([], 10) == sparkline([1.0], 0) == ""


@pytest.mark.parametrize("width", [1, 7, 20, 40, 80, 200])
def test_no_line_of_a_panel_is_wider_than_the_terminal(width: int):
    history = History()
    shown: list[list[str]] = []

    def watch(iterate: Iterate) -> None:
        history.add(iterate)
        shown.append(panel_lines(history, "a long title that wraps", width))

    seen_by(watch, max_iterations=4)
    assert max(cell_len(line) for panel in shown for line in panel) <= width


def test_a_panel_tells_solve_iteration_figures_and_history():
    history = History()
    assert panel_lines(history, "hop", 100) == ["hop: building and compiling"]
    figures: list[dict[str, float]] = []

    def watch(iterate: Iterate) -> None:
        history.add(iterate)
        if iterate.stage == "iteration":
            figures.append(dict(iterate.figures))

    seen_by(watch, label="rung 2 of 3")
    head, solve_line, objective, primal, dual, step = panel_lines(history, "hop", 100)
    last = figures[-1]
    assert head.startswith(f"hop: solved, iteration {last['iteration']:.0f}, ")
    assert solve_line.startswith("rung 2 of 3, legendre:1, ")
    assert f"{last['objective']:.6g}" in objective
    assert f"{last['primal']:.1e}" in primal
    assert f"{last['dual']:.1e}" in dual
    assert step.startswith(f"step {last['step']:.2g}")
    for line, name in ((primal, "primal"), (dual, "dual")):
        assert line.endswith(sparkline([row[name] for row in figures], 100))


def test_a_panel_of_ascii_has_ascii_alone():
    history = History()
    seen_by(history.add)
    text = "".join(panel_lines(history, "hop", 100, plain=True))
    assert text.isascii()
    assert ASCII[0] in text


def row(**figures: float) -> dict[str, float]:
    return {"iteration": 1.0, "time": 1.0, **dict.fromkeys(FIGURES, 0.0), "step": 1.0, **figures}


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"restoration": 1.0}, "restoration"),
        ({"regularization": 1e-3}, "Hessian regularised by 1e-03"),
        ({"line_search": 8.0, "step": 1e-2}, "cut the step 7 times"),
        ({"step": 1e-5}, "very short step"),
    ],
)
def test_trouble_is_told_in_words(figures: dict[str, float], words: str):
    history = History(number=1, rows=[row(), row(**figures)])
    assert words in " ".join(history.troubles())
    assert words in panel_lines(history, "hop", 200)[-1]


def test_a_step_without_trouble_has_no_words():
    assert History(number=1, rows=[row(), row()]).troubles() == []


def test_infeasible_rows_are_seen_as_restoration():
    history, states = History(), set()

    def watch(iterate: Iterate) -> None:
        history.add(iterate)
        states.add(history.state())

    seen_by(watch, perturb=3.0, seed=1, max_iterations=60)
    assert "restoring feasibility" in states


def test_every_solve_of_a_ladder_says_which_it_is():
    labels: list[str] = []
    history = History()

    def watch(iterate: Iterate) -> None:
        history.add(iterate)
        if iterate.stage == "guess":
            labels.append(iterate.label)
            assert history.rows == []

    solve_ladder(small(), [("legendre:1", 8), ("legendre:1", 12)], compare=True, watch=watch)
    assert labels == ["rung 1 of 2", "rung 2 of 2", "from the default guess"]
    assert history.number == 3


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_table_has_every_iteration_as_the_progress_was_told_it(solver: str, tmp_path: Path):
    told: list[dict[str, float]] = []
    with IterationTable(tmp_path / "log.csv") as table:
        seen_by(table, solver=solver, progress=lambda figures: told.append(figures) is None, label="a, b")
    rows = list(csv.DictReader((tmp_path / "log.csv").open()))
    assert tuple(rows[0]) == COLUMNS
    assert [int(entry["iteration"]) for entry in rows] == [info["iteration"] for info in told]
    for entry, info in zip(rows, told, strict=True):
        assert (entry["solve"], entry["label"], entry["solver"]) == ("1", "a, b", solver)
        for name in FIGURES:
            assert float(entry[name]) == pytest.approx(float(info[name]), rel=1e-8, abs=1e-300)
    times = [float(entry["time_s"]) for entry in rows]
    assert times == sorted(times)


def test_a_table_that_cannot_be_written_is_refused_in_one_line(tmp_path: Path):
    with refused("cannot write"):
        IterationTable(tmp_path / "none" / "log.csv")


def test_lines_have_one_iteration_each(capsys: pytest.CaptureFixture[str]):
    told: list[float] = []
    seen_by(IterationLines(sys.stderr, "hop"), progress=lambda f: told.append(f["iteration"]) is None)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("hop: legendre:1")
    assert lines[-1].startswith("hop: solved, ")
    numbers = [int(line.split()[0]) for line in lines[1:-1] if not line.startswith(" iter")]
    assert numbers == told


def test_a_watch_that_fails_is_one_warning_and_the_others_go_on():
    seen: list[str] = []

    def fail(iterate: Iterate) -> None:
        raise LookupError("from\nthe watch")

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        seen_by(combine_watches(fail, None, lambda iterate: seen.append(iterate.stage)))
    (text,) = [str(warning.message) for warning in caught if "watching has stopped" in str(warning.message)]
    assert text == "watching has stopped, solving goes on: LookupError: from the watch"
    assert (seen[0], seen[-1]) == ("guess", "end")


def test_an_interrupt_in_a_watch_stops_the_solver():
    def interrupt(iterate: Iterate) -> None:
        if iterate.stage == "iteration" and iterate.figures["iteration"] == 2:
            raise KeyboardInterrupt

    solution = solve(small(), transcription="legendre:1", watch=interrupt)
    assert solution.statistics.status == "interrupted"


def test_figures_alone_never_request_the_variables(tmp_path: Path):
    asked: list[str] = []

    def refuse(iterate: Iterate) -> None:
        def read() -> np.ndarray:
            asked.append(iterate.stage)
            return iterate.read()

        told(replace(iterate, read=read))

    history = History()
    with IterationTable(tmp_path / "log.csv") as table:
        told = combine_watches(table, history.add, lambda iterate: panel_lines(history, "hop", 80) and None)
        seen_by(refuse)
    assert history.rows
    assert asked == []


BUSY = """\
import time
from trajopt.cli import progress
progress.SECOND = 0.4
with progress.busy("diagnosing jump.npz"):
    time.sleep(1.0)
print("done")
"""


def test_what_lasts_says_on_a_terminal_what_it_does_and_for_how_long() -> None:
    status, output, seen = AtTerminal(sys.executable, "-c", BUSY, piped=True).finish()
    assert (status, output) == (0, "done\n")
    assert "\rdiagnosing jump.npz, 1 s" in seen
    assert seen.endswith("\r\x1b[K")


def test_elsewhere_nothing_is_shown_while_waiting() -> None:
    done = python(BUSY)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
