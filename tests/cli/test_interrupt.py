"""Ctrl-C on the command line, in real processes on a real terminal."""

import json
import re
import signal
import sys
import uuid
from pathlib import Path

import pytest

from tests.support.problems import hop
from tests.support.processes import COLUMNS, TRAJOPT, AtTerminal, needs_proc, processes, python, run, until
from trajopt import Solution, solve

pytestmark = pytest.mark.long

# So many intervals that building lasts seconds, and a linear solver with which solving does.
LONG = (
    "solve", "solo12-jump", "--set", "distance=0.3",
    "--solver-option", "linear_solver=mumps", "--intervals", "200",
)  # fmt: skip


def trajopt(*arguments: object) -> AtTerminal:
    """``trajopt`` with stdout on a pipe and stderr on a terminal."""
    return AtTerminal(*TRAJOPT, *arguments, piped=True)


def test_ctrl_c_while_solving_keeps_the_iterate(tmp_path: Path) -> None:
    target = tmp_path / "x.npz"
    with trajopt(*LONG, "--output", target, "--json") as process:
        process.read_until("iteration 2")
        process.press()
        status, output, _ = process.finish()
    report = json.loads(output)
    assert status == 1
    assert (report["success"], report["status"]) == (False, "interrupted")
    assert report["iterations"] >= 2
    assert Solution.load(target).statistics.status == "interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_ctrl_c_while_building_leaves_nothing(tmp_path: Path) -> None:
    with trajopt(*LONG, "--output", tmp_path / "x.npz", "--json") as process:
        process.read_until("building")
        process.press()
        status, output, seen = process.finish()
    assert (status, output) == (130, "")
    assert "trajopt: cancelled" in seen
    assert "Traceback" not in seen
    assert not list(tmp_path.iterdir())


def test_the_panel_fits_the_terminal_and_is_gone_at_the_end(tmp_path: Path) -> None:
    short = (*LONG[:-1], "12", "--max-iterations", 3, "--output", tmp_path / "x.npz", "--json")
    with trajopt(*short) as process:
        status, output, seen = process.finish()
    assert status == 1
    assert json.loads(output)["status"] == "iteration_limit"
    assert "iteration 3" in seen
    assert "infeasibility" in seen
    left, widest = on_screen(seen)
    assert left == []
    assert widest < COLUMNS


def on_screen(text: str) -> tuple[list[str], int]:
    """The lines that a terminal shows in the end, and the columns of the widest it ever showed."""
    screen, row, widest = [""], 0, 0
    for part in re.split(r"(\x1b\[[?0-9;]*[A-Za-z]|\r|\n)", text):
        if part == "\n":
            row += 1
            screen += [""] * (row + 1 - len(screen))
        elif part.endswith("A") and part.startswith("\x1b"):
            row -= int(part[2:-1])
        elif part == "\x1b[2K":
            screen[row] = ""
        elif part and part[0] not in "\r\x1b":
            screen[row] = part if len(part) >= len(screen[row]) else part + screen[row][len(part) :]
            widest = max(widest, len(screen[row]))
    return [line for line in screen if line.strip()], widest


@pytest.fixture(scope="module")
def solution_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return solve(hop(), intervals=8).save(tmp_path_factory.mktemp("solution") / "hop.npz")


def test_ctrl_c_ends_a_live_replay_with_zero(solution_file: Path) -> None:
    with trajopt("replay", solution_file, "--no-open") as shown:
        shown.read_until("Ctrl-C stops the server")
        shown.press()
        status, output, seen = shown.finish()
    assert status == 0
    assert "http://" in output
    assert "Traceback" not in seen


IGNORING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.execv(sys.executable, [sys.executable, "-m", "trajopt", *sys.argv[1:]])
"""


@needs_proc
def test_where_ctrl_c_is_ignored_sigterm_ends_command_and_server(solution_file: Path) -> None:
    marker = uuid.uuid4().hex
    command = (sys.executable, "-c", IGNORING, "replay", solution_file, "--no-open")
    with AtTerminal(*command, piped=True, environment={"MARKER": marker}) as shown:
        shown.read_until("Ctrl-C stops the server")
        shown.press()
        assert len(processes(marker)) == 2
        shown.press(signal.SIGTERM)
        status, _, _ = shown.finish()
    assert status == -signal.SIGTERM
    assert until(lambda: not processes(marker))


LAUNCH = """
import builtins, os, signal, sys
from trajopt.cli import main
imported = builtins.__import__
def lost(name, *arguments):
    if name == "trajopt.cli.commands":
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            pass
    return imported(name, *arguments)
builtins.__import__ = lost
sys.exit(main())
"""


def test_ctrl_c_that_an_import_loses_ends_the_command() -> None:
    done = python(LAUNCH, "list")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "trajopt: cancelled\n")


# Under `-m` CPython would end by the signal, where the exception came from executed text.
MODULE = """\
import sys
from trajopt.cli import commands, main
commands.main = lambda: exec("raise KeyboardInterrupt")
sys.exit(main())
"""


def test_ctrl_c_in_executed_text_ends_a_module_with_the_status(tmp_path: Path) -> None:
    (tmp_path / "command.py").write_text(MODULE, "utf-8")
    done = run(sys.executable, "-m", "command", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "trajopt: cancelled\n")
