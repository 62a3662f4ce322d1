"""Asking for functions to be compiled beside a solve, for the next one.

A solve leaves a request for every entry that it lacks in a folder of the cache, and starts a worker
(`background_worker`), a process of its own session that Ctrl-C in the terminal does not reach. One worker at
a time compiles what is asked for, and one more waits for it: that one looks at the folder after the first
has, so that no request is overlooked, and all others end at once.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import uuid
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import asdict, dataclass
from pathlib import Path

_WORKER = "trajopt.transcription.background_worker"
# Workers of this process: one that has ended is a zombie until it is asked for its status.
_started: list[subprocess.Popen[bytes]] = []
# Compiled entries that the virtual machine stands in for, while `same_functions` lasts.
_STAND_INS: ContextVar[set[str] | None] = ContextVar("stand_ins", default=None)


@contextlib.contextmanager
def same_functions() -> Iterator[None]:
    """Solves within that begin on the virtual machine stay there, whenever the background's compiler ends.

    Rounding differs between the two: the result would depend on how fast the machine compiles.
    """
    token = _STAND_INS.set(_STAND_INS.get() or set())
    try:
        yield
    finally:
        _STAND_INS.reset(token)


def stand_ins() -> set[str] | None:
    """Keys of compiled entries that are not to be used within `same_functions`; None outside."""
    return _STAND_INS.get()


@dataclass(frozen=True, kw_only=True)
class Request:
    """An entry to compile from functions that other entries hold in serialised form.

    key: the entry's. compiler: path. made_by: as the key takes it, so that nothing is made that another
    compiler or processor should make. names: the functions'. entries: where they may be.
    """

    key: str
    point: str
    level: str
    compiler: str
    made_by: str
    names: tuple[str, ...]
    entries: tuple[str, ...]


@dataclass(frozen=True)
class Room:
    """The background's files in the cache: requests, entries being written, locks, the last failure."""

    cache: Path

    @property
    def folder(self) -> Path:
        """All of it."""
        return self.cache / ".background"

    @property
    def requests(self) -> Path:
        """One file for each, named for the entry."""
        return self.folder / "requests"

    @property
    def unfinished(self) -> Path:
        """Entries being written by the worker that runs."""
        return self.folder / "unfinished"

    @property
    def failure(self) -> Path:
        """Why the last entry could not be made, in one line; missing after a success."""
        return self.folder / "failure"


def ask(cache: Path, requests: Sequence[Request]) -> str | None:
    """Leave requests and start a worker, which the caller does not wait for; return the last failure.

    Where that is not possible (a full disk, no process can be started) nothing is compiled, and nothing
    else is lost: the failure says why.
    """
    room = Room(cache)
    try:
        room.requests.mkdir(mode=0o700, parents=True, exist_ok=True)
        for request in requests:
            _write(room.requests / f"{request.key}.json", json.dumps(asdict(request)))
        _start(cache)
    except OSError as error:
        return f"{error.strerror or error}"
    with contextlib.suppress(OSError):
        return room.failure.read_text(encoding="utf-8").strip() or None
    return None


def _write(file: Path, text: str) -> None:
    """Write a file that appears whole; raises OSError."""
    temporary = file.with_name(f".{uuid.uuid4().hex}")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.rename(file)
    finally:
        temporary.unlink(missing_ok=True)


def _start(cache: Path) -> None:
    """Start a worker, which finds modules where this process does; raises OSError."""
    _started[:] = [process for process in _started if process.poll() is None]
    path = [os.path.abspath(folder) for folder in sys.path]
    _started.append(
        subprocess.Popen(
            [sys.executable or "python3", "-P", "-m", _WORKER, str(cache.resolve())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            cwd="/",  # no folder is kept from being removed or unmounted
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        )
    )
