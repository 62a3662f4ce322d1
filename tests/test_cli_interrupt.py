"""Ctrl-C on the command line, in real processes on a real terminal."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from trajopt import Solution

# So many intervals that building and solving last seconds.
LONG = ("solve", "solo12-jump", "--set", "distance=0.3", "--intervals", "200")
WAIT = 120.0
COLUMNS = 80


class Process:
    """``trajopt`` with stdout on a pipe and stderr on a terminal of ``COLUMNS`` columns."""

    def __init__(self, *arguments: object) -> None:
        self.terminal, end = pty.openpty()
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": str(COLUMNS)}
        command = [sys.executable, "-m", "trajopt", *map(str, arguments)]
        # Ctrl-C works as in a terminal, also where the tests themselves run under nohup.
        self.popen = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=end, env=environment, start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip
        os.close(end)
        self.seen = ""

    def read_until(self, words: str) -> None:
        deadline = time.monotonic() + WAIT
        while words not in self.seen:
            assert time.monotonic() < deadline, self.seen[-500:]
            assert self._read(), f"ended without {words!r}: {self.seen[-500:]}"

    def _read(self) -> bool:
        ready, _, _ = select.select([self.terminal], [], [], 0.2)
        if not ready:
            return True
        try:
            data = os.read(self.terminal, 65536)
        except OSError:  # Linux: the other end is closed
            return False
        self.seen += data.decode(errors="replace")
        return bool(data)

    def press(self) -> None:
        self.popen.send_signal(signal.SIGINT)

    def finish(self) -> tuple[int, str]:
        while self._read():
            pass
        os.close(self.terminal)
        output, _ = self.popen.communicate(timeout=WAIT)
        return self.popen.returncode, output.decode()


def test_ctrl_c_while_solving_keeps_the_iterate(tmp_path: Path) -> None:
    target = tmp_path / "x.npz"
    process = Process(*LONG, "--output", target, "--json")
    process.read_until("iteration 2")
    process.press()
    status, output = process.finish()
    found = json.loads(output)
    assert status == 1
    assert (found["success"], found["status"]) == (False, "interrupted")
    assert found["iterations"] >= 2
    assert Solution.load(target).meta["status"] == "interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_ctrl_c_while_building_leaves_nothing(tmp_path: Path) -> None:
    process = Process(*LONG, "--output", tmp_path / "x.npz", "--json")
    process.read_until("building")
    process.press()
    status, output = process.finish()
    assert (status, output) == (130, "")
    assert "trajopt: cancelled" in process.seen
    assert "Traceback" not in process.seen
    assert not list(tmp_path.iterdir())


def test_the_panel_fits_the_terminal_and_is_gone_at_the_end(tmp_path: Path) -> None:
    process = Process(*LONG[:-1], "12", "--max-iterations", 3, "--output", tmp_path / "x.npz", "--json")
    status, output = process.finish()
    assert status == 1
    assert json.loads(output)["status"] == "iteration_limit"
    assert "iteration 3" in process.seen
    assert "infeasibility" in process.seen
    left, widest = on_screen(process.seen)
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


SECOND_PRESS = """
import os, signal, time
from trajopt.cli.progress import Interruption
with Interruption() as interruption:
    interruption.started = True
    for _ in range(2):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.5)
    print("still here", interruption.requested, flush=True)
    time.sleep(10)
"""


def test_second_ctrl_c_ends_a_solver_that_does_not_answer() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SECOND_PRESS], capture_output=True, text=True, timeout=WAIT, check=False
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "trajopt: cancelled, nothing was written\n"


IGNORED = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
from trajopt.cli.progress import Interruption
with Interruption():
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
"""


def test_ctrl_c_that_is_ignored_stays_ignored() -> None:
    subprocess.run([sys.executable, "-c", IGNORED], timeout=WAIT, check=True)


def test_ctrl_c_ends_a_live_replay_with_zero(tmp_path: Path) -> None:
    target = tmp_path / "x.npz"
    process = Process(*LONG[:-1], "12", "--max-iterations", 1, "--output", target)
    assert process.finish()[0] == 1
    shown = Process("replay", target, "--no-open")
    shown.read_until("Ctrl-C stops the server")
    shown.press()
    status, output = shown.finish()
    assert status == 0
    assert "http://" in output
    assert "Traceback" not in shown.seen
