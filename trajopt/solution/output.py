"""Where a solution is to be written: checked before anything is computed."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from trajopt.errors import InputError


def check_output(path: Path) -> Path:
    """The path, if a solution can be written there; raises `InputError` before anything is computed."""
    target = path.expanduser()
    allowed = "allowed: a file in an existing folder that can be written"
    with contextlib.suppress(OSError):
        if target.is_dir():
            raise InputError(f"cannot write {target}: it is a folder", allowed)
        if target.exists() and not target.is_file():
            raise InputError(f"cannot write {target}: it is no regular file", allowed)
    try:  # as the solution file is written: a temporary file beside it, renamed
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
        os.close(handle)
        os.unlink(name)
    except OSError as error:
        reason = _reason(target) or error.strerror or str(error)
        raise InputError(f"cannot write {target}: {reason}", allowed) from None
    return target


def check_apart(targets: Sequence[Path | None], sources: Sequence[Path]) -> None:
    """Raise `InputError` where what is written would replace what is read, or is one file twice."""
    read = {_place(source) for source in sources}
    written: set[Path] = set()
    for target in filter(None, targets):
        place = _place(target)
        if place in read:
            raise InputError(f"{target} is what is read", "allowed: another name for what is written")
        if place in written:
            raise InputError(f"{target} is written twice", "allowed: a name of its own for each")
        written.add(place)


def _place(path: Path) -> Path:
    with contextlib.suppress(OSError, RuntimeError):  # a loop of links, a home that is not known
        return path.expanduser().resolve()
    return path


def _reason(target: Path) -> str:
    folder = target.parent
    with contextlib.suppress(OSError):
        if not folder.exists():
            return f"the folder {folder} does not exist"
        if not folder.is_dir():
            return f"{folder} is not a folder"
    return ""
