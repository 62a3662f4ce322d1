"""A press of Ctrl-C has its effect whatever the program does when it comes."""

import json
import re
import signal
import sys
import uuid
from pathlib import Path

import pytest

from tests.support.problems import hop
from tests.support.processes import (
    COLUMNS,
    TRAJOPT,
    AtTerminal,
    ctrl_c_here,
    needs_proc,
    processes,
    python,
    run,
    until,
)
from trajopt import Solution, solve
from trajopt.cli.interruption import Interruption

PRESSED = """
import contextlib, os, signal, sys, threading, time
from trajopt.cli.interruption import Interruption

interruption = Interruption()
def press():
    os.kill(os.getpid(), signal.SIGINT)

"""
# A test waits for what is to happen far below the limit after which it fails.
FOR_EVER = "time.sleep(3600)"


def outcome(code: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of a program that presses Ctrl-C itself."""
    done = python(PRESSED + code)
    return done.returncode, done.stdout, done.stderr


def test_a_press_is_a_keyboard_interrupt() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    threading.Timer(0.1, press).start()
    {FOR_EVER}
print("ended")
"""
    assert outcome(code) == (0, "ended\n", "")


def test_second_press_ends_a_solver_that_does_not_answer() -> None:
    code = f"""
with interruption.handling(), interruption.deferring():
    press(), press()
    {FOR_EVER}
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


# A call of the C library that is not interrupted, and that releases Python's lock as solvers do.
NATIVE = """
import ctypes
signal.siginterrupt(signal.SIGINT, False)
lock = ctypes.CDLL(None).pthread_mutex_lock
mutex = ctypes.create_string_buffer(64)
def forever():
    lock(mutex), lock(mutex)
"""


@pytest.mark.parametrize("state", ["interruption.deferring()", "contextlib.nullcontext()"])
def test_second_press_ends_native_code_that_does_not_return(state: str) -> None:
    code = f"""{NATIVE}
with interruption.handling(), {state}:
    for delay in (0.2, 0.4):
        threading.Timer(delay, press).start()
    forever()
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


def test_a_press_in_a_destructor_is_known_and_not_told_and_other_errors_are() -> None:
    code = """
class Last:
    def __init__(self, do):
        self.do = do
    def __del__(self):
        self.do()
        sum(range(1000))
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    Last(press)
    print(interruption.pressed)
    interruption.check()
    print("not reached")
with interruption.handling():
    Last(lambda: 1 / 0)
"""
    status, output, errors = outcome(code)
    assert (status, output) == (0, "True\n")
    assert errors.startswith("Exception ignored in")
    assert errors.rstrip().endswith("ZeroDivisionError: division by zero")
    assert errors.count("Exception ignored in") == 1


def test_a_press_that_a_library_loses_is_known_and_a_second_one_is_raised() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    try:
        press()
        {FOR_EVER}
    except BaseException:
        pass
    print(interruption.pressed)
    press()
    {FOR_EVER}
print("ended")
"""
    assert outcome(code) == (0, "True\nended\n", "")


@pytest.mark.long
def test_what_is_cleaned_up_after_a_press_is_cleaned_up_whole() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    try:
        press()
        {FOR_EVER}
    finally:
        try:
            raise ValueError
        except ValueError:
            time.sleep(0.3)
        press()
        time.sleep(0.3)
        print("cleaned up")
"""
    assert outcome(code) == (0, "cleaned up\n", "")


def test_third_press_ends_a_cleaning_up_that_does_not_end() -> None:
    code = f"""
with interruption.handling():
    try:
        press()
        {FOR_EVER}
    finally:
        press(), press()
        {FOR_EVER}
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


def test_a_deferred_press_is_raised_where_deferring_ends() -> None:
    code = """
with interruption.handling():
    try:
        with interruption.deferring():
            press()
            print(interruption.pressed)
    except KeyboardInterrupt:
        interruption.answer()
        print("raised", interruption.pressed)
    with interruption.deferring():
        press()
        interruption.answer()
    time.sleep(0.3)
    print("answered")
"""
    assert outcome(code) == (0, "True\nraised False\nanswered\n", "")


def test_handling_within_handling_changes_nothing() -> None:
    code = """
with interruption.handling(), interruption.deferring():
    press()
    with interruption.handling():
        print(interruption.pressed)
    interruption.answer()
print(interruption.pressed)
"""
    assert outcome(code) == (0, "True\nFalse\n", "")


def test_handlers_are_as_before_afterwards() -> None:
    handler = signal.getsignal(signal.SIGINT)
    with ctrl_c_here():
        with Interruption().handling():
            assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is handler
    assert signal.set_wakeup_fd(-1) == -1


def test_ctrl_c_that_is_ignored_stays_ignored() -> None:
    code = """
signal.signal(signal.SIGINT, signal.SIG_IGN)
with interruption.handling():
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    press()
    assert not interruption.pressed
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
"""
    assert outcome(code) == (0, "", "")


# So many intervals that building lasts seconds, and a linear solver with which solving does.
LONG = (
    "solve", "solo12-jump", "--set", "distance=0.3",
    "--solver-option", "linear_solver=mumps", "--intervals", "200",
)  # fmt: skip


def trajopt(*arguments: object) -> AtTerminal:
    """``trajopt`` with stdout on a pipe and stderr on a terminal."""
    return AtTerminal(*TRAJOPT, *arguments, piped=True)


@pytest.mark.long
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


@pytest.mark.long
def test_ctrl_c_while_building_leaves_nothing(tmp_path: Path) -> None:
    with trajopt(*LONG, "--output", tmp_path / "x.npz", "--json") as process:
        process.read_until("building")
        process.press()
        status, output, seen = process.finish()
    assert (status, output) == (130, "")
    assert "trajopt: cancelled" in seen
    assert "Traceback" not in seen
    assert not list(tmp_path.iterdir())


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
def test_ctrl_c_in_executed_text_ends_a_module_with_the_status(tmp_path: Path) -> None:
    (tmp_path / "command.py").write_text(MODULE, "utf-8")
    done = run(sys.executable, "-m", "command", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "trajopt: cancelled\n")
