"""The process that compiles what solves have asked for: ``python -m`` this module, with the cache's folder.

It knows neither robot nor problem: the functions are in the cache, serialised for the virtual machine. A
worker that is killed releases its locks and leaves files that the next one removes. A request is withdrawn
before it is dealt with, so that one that ends the process does not end all that follow.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from trajopt.errors import TrajoptError
from trajopt.transcription.background import Request, Room

LEAST_PRIORITY = 19
# A compiler that takes longer hangs, s.
LONGEST = 3600.0


def main(cache: Path) -> None:
    """Compile what is asked for, unless another worker does or will; returns when nothing is left."""
    _step_back()
    room = Room(cache)
    try:
        with open(room.folder / "waiting", "w", encoding="utf-8") as waiting:
            if not _locked(waiting, fcntl.LOCK_EX | fcntl.LOCK_NB):
                return
            working = open(room.folder / "working", "w", encoding="utf-8")  # noqa: SIM115
            _locked(working, fcntl.LOCK_EX)
        with working:
            shutil.rmtree(room.unfinished, ignore_errors=True)
            for request in _requests(room, working):
                _answer(room, request)
    except OSError:
        return  # the folder was removed or cannot be written: the next solve asks again


def _step_back() -> None:
    """Take the least share of the processor."""
    os.nice(LEAST_PRIORITY)
    with contextlib.suppress(OSError):  # Linux: a session is a group, which nice does not compare with others
        Path("/proc/self/autogroup").write_text(str(LEAST_PRIORITY), encoding="ascii")


def _locked(file: TextIO, how: int) -> bool:
    """Whether the lock is had; the kernel releases it when the file is closed, or the process ends."""
    try:
        fcntl.flock(file, how)
    except BlockingIOError:
        return False
    return True


def _requests(room: Room, lock: TextIO) -> Iterator[Request]:
    """Requests, the oldest first, until none is left or the lock's file is no longer the cache's."""
    while os.path.samestat(os.fstat(lock.fileno()), (room.folder / "working").stat()):
        files = [file for file in room.requests.iterdir() if file.suffix == ".json"]
        if not files:
            return
        oldest = min(files, key=lambda file: file.stat().st_mtime_ns)
        text = oldest.read_text(encoding="utf-8")
        oldest.unlink()
        with contextlib.suppress(ValueError, TypeError):  # of another version
            values = json.loads(text)
            values |= {name: tuple(values[name]) for name in ("names", "entries")}
            yield Request(**values)


def _answer(room: Room, request: Request) -> None:
    """Make an entry; why that failed is noted."""
    from trajopt.transcription.cache_entries import EntryWriter, intact

    final = room.cache / request.key
    if intact(final):
        return
    writer = EntryWriter(final, request.point, request.level, room.unfinished)
    try:
        writer.open()
        writer.move_into_place(
            sum(_compiled(room, request, name, writer.temporary) for name in request.names)
        )
        room.failure.unlink(missing_ok=True)
        for entry in request.entries:
            _remove_needless(room, room.cache / entry, request.names)
    except (OSError, RuntimeError, TrajoptError, subprocess.TimeoutExpired) as error:
        with contextlib.suppress(OSError):
            room.failure.write_text(" ".join(str(error).split()), encoding="utf-8")
    finally:
        writer.discard()


def _remove_needless(room: Room, entry: Path, names: tuple[str, ...]) -> None:
    """Remove an entry of the virtual machine whose functions are all compiled now, tens of megabytes.

    It vanishes at once: a process that was about to read it builds the graphs again, in about the same time.
    """
    if {file.stem for file in entry.glob("*.casadi")} <= set(names):
        with contextlib.suppress(OSError):  # it has been removed
            aside = room.unfinished / f"{entry.name}.removed"
            entry.rename(aside)
            shutil.rmtree(aside, ignore_errors=True)


def _compiled(room: Room, request: Request, name: str, folder: Path) -> int:
    """Compile one function; return the size of its C. Raises what `_answer` notes."""
    import casadi as ca

    from trajopt.transcription.c_compiler import command, complaint, generate, made_by, version_line
    from trajopt.transcription.cache_entries import intact

    if made_by(request.level, (request.compiler, version_line(request.compiler))) != request.made_by:
        raise TrajoptError("the compiler or the processor is another than the solve's")
    texts = (room.cache / entry / f"{name}.casadi" for entry in request.entries if intact(room.cache / entry))
    text = next((text for text in texts if text.is_file()), None)
    if text is None:
        raise TrajoptError("the functions are no longer in the cache")
    source = generate(name, ca.Function.deserialize(text.read_text(encoding="utf-8")), folder)
    done = subprocess.run(
        command(request.compiler, request.level, source),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        timeout=LONGEST,
        env={**os.environ, "TMPDIR": str(folder)},  # removed with the folder if this process is killed
        check=False,
    )
    if done.returncode != 0:
        raise TrajoptError(f"the C compiler failed: {complaint(done.stderr, done.returncode)}")
    return source.stat().st_size


if __name__ == "__main__":
    main(Path(sys.argv[1]))
