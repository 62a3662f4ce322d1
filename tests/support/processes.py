"""Processes for tests: signals reach them wherever the tests run, and no wait for them is without a limit."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

from tests.support.repository import ROOT

# Seconds that a process, or what a test waits for, may take on a machine that does other things too: a guard
# against waiting for ever, which no test measures. Below pytest's own limit: the test can say what it saw.
LIMIT = 300
# Seconds between two looks.
LOOK = 0.05
COLUMNS = 80
TRAJOPT = (sys.executable, "-m", "trajopt")
# What a shell script starts in the background ignores SIGINT, with all its children; others block signals.
AS_AT_A_TERMINAL = """
import os, signal, sys
numbers = signal.SIGINT, signal.SIGTERM
for number in numbers:
    signal.signal(number, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)
os.execv(sys.argv[1], sys.argv[1:])
"""
needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="no /proc to look at")


def interruptible(command: tuple[object, ...]) -> list[str]:
    """The command with SIGINT and SIGTERM as a terminal's shell leaves them."""
    return [sys.executable, "-ISc", AS_AT_A_TERMINAL, *map(str, command)]


@contextmanager
def ctrl_c_here() -> Iterator[None]:
    """SIGINT is a KeyboardInterrupt in this process, wherever the tests run."""
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)


def run(*command: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """A process and what it writes; one that does not end within `LIMIT` fails the test."""
    return subprocess.run(
        interruptible(command),
        **{"capture_output": True, "text": True, "stdin": subprocess.DEVNULL, "timeout": LIMIT, **options},
    )


def python(code: str, *arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """As `run`, of a script that is given as text."""
    return run(sys.executable, "-c", code, *arguments, **options)


def until(holds: Callable[[], Any]) -> Any:
    """What ``holds()`` returns as soon as that is true, or at the latest after `LIMIT`."""
    end = time.monotonic() + LIMIT
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(LOOK)
    return found


def environment(*folders: Path, **variables: str) -> dict[str, str]:
    """Of a process that finds modules in those folders, and the tests' own as ``tests.support``."""
    path = [*map(str, folders), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, **variables, "PYTHONPATH": os.pathsep.join(path)}


def processes(marker: str, words: str = "") -> dict[int, str]:
    """Commands by number of the processes whose environment holds ``marker`` and whose command ``words``."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            given, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
        except OSError:
            continue
        if marker.encode() in given and words.encode() in command:
            found[int(folder.name)] = command.replace(b"\0", b" ").decode()
    return found


def task_processes(package: Path) -> dict[int, str]:
    """Processes of tasks and their server that were started with that folder on their path."""
    return processes(str(package), "multiprocessing.forkserver")


def no_task_process_left(package: Path) -> bool:
    """Whether all of them end, within `LIMIT`."""
    return until(lambda: not task_processes(package))


class Running:
    """A process that is killed, with its group, when it is left or after `LIMIT`: no read waits longer."""

    def __init__(self, *command: object, **options: Any) -> None:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
        self.popen = subprocess.Popen(
            interruptible(command), start_new_session=True, text=True, **{**pipes, **options}
        )
        self._guard = threading.Timer(LIMIT, self.kill)
        self._guard.daemon = True
        self._guard.start()

    def __enter__(self) -> Running:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._guard.cancel()
        self.kill()
        self.popen.communicate(timeout=LIMIT)

    def line(self) -> str:
        """The next line that it writes to stderr; empty at the end."""
        assert self.popen.stderr is not None
        return self.popen.stderr.readline()

    def press(self, number: signal.Signals = signal.SIGINT) -> None:
        """Ctrl-C, as a terminal sends it: to the whole group."""
        os.killpg(self.popen.pid, number)

    def kill(self) -> None:
        """End it and its group."""
        if self.popen.poll() is None:
            os.killpg(self.popen.pid, signal.SIGKILL)

    def finish(self) -> tuple[int, str, str]:
        """Exit status, and what is left of stdout and stderr."""
        output, errors = self.popen.communicate(timeout=LIMIT)
        return self.popen.returncode, output or "", errors or ""


class AtTerminal(Running):
    """A process whose stdin and stderr are a terminal of `COLUMNS` columns; stdout too, or else a pipe."""

    def __init__(self, *command: object, piped: bool = False, environment: dict[str, str] | None = None):
        self.terminal, end = pty.openpty()
        known = {**os.environ, **(environment or {}), "TERM": "xterm", "COLUMNS": str(COLUMNS)}
        shown = {name: value for name, value in known.items() if name not in ("DISPLAY", "BROWSER")}
        output = subprocess.PIPE if piped else end
        super().__init__(*command, stdin=end, stdout=output, stderr=end, env=shown)
        os.close(end)
        self.seen = ""

    def read_until(self, words: str) -> None:
        """Read the terminal until it has shown ``words``."""
        while words not in self.seen:
            assert self._read(), f"ended without {words!r}: {self.seen[-500:]}"

    def finish(self) -> tuple[int, str, str]:
        """Exit status, stdout where it is piped, and all that the terminal has shown."""
        while self._read():
            pass
        os.close(self.terminal)
        status, output, _ = super().finish()
        return status, output, self.seen

    def _read(self) -> bool:
        """Read on; False at the end, which comes after `LIMIT` at the latest: then the process is killed."""
        if not select.select([self.terminal], [], [], LOOK)[0]:
            return True
        try:
            data = os.read(self.terminal, 65536)
        except OSError:  # Linux: the other end is closed
            return False
        self.seen += data.decode(errors="replace")
        return bool(data)
