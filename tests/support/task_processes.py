"""Processes of tasks and their server, as /proc shows them."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="no /proc to look at")


def task_processes(package: Path) -> list[int]:
    """Those that were started with that folder on their path."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            given, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
        except OSError:
            continue
        if str(package).encode() in given and b"multiprocessing.forkserver" in command:
            found.append(int(folder.name))
    return found


def task_processes_left(package: Path, seconds: float) -> list[int]:
    """Those that are there after so many seconds; none as soon as there is none."""
    deadline = time.monotonic() + seconds
    while (found := task_processes(package)) and time.monotonic() < deadline:
        time.sleep(0.1)
    return found
