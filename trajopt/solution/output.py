"""Output files: the path is checked before anything is computed; then written completely or not at all."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from trajopt.errors import InputError, expanded

ALLOWED = "allowed: a file in an existing folder that can be written"
ALLOWED_FOLDER = "allowed: a new name in an existing folder that can be written"
# Bits of a file's mode that allow writing.
WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
# First bytes of solution files.
ARCHIVE = b"PK"


def check_output(path: Path) -> Path:
    """The path, if a file can be written there; raises `InputError` before anything is computed."""
    target = expanded(path)
    _require_file(target)
    _require_place(target, ALLOWED)
    return target


def require_ending(path: Path, ending: str) -> None:
    """Raise `InputError` unless a file's name has that ending."""
    if path.suffix.lower() != ending:
        raise InputError(f"the name of {path} does not end with {ending}", f"allowed: NAME{ending}")


def check_solution_output(path: Path) -> Path:
    """As `check_output`, of a solution file (.npz); one that holds something else is not written over."""
    target = check_output(path)
    if target.suffix:
        require_ending(target, ".npz")
    with contextlib.suppress(OSError), target.open("rb") as old:
        start = old.read(len(ARCHIVE))
        if start not in (b"", ARCHIVE):
            raise InputError(
                f"cannot write {target}: it is there and is no solution file", "allowed: another name"
            )
    return target


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Give a file to write, and move it to ``target`` at the end; after an error the old file stays.

    The file has the target's name, in a temporary folder beside it. Raises a one-line `InputError` if it
    cannot be written.
    """
    _require_file(target)
    try:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.") as folder:
            unfinished = Path(folder, target.name)
            yield unfinished
            os.replace(unfinished, target)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}", ALLOWED) from None


@contextlib.contextmanager
def replacing_folder(target: Path, marker: str) -> Iterator[Path]:
    """Give an empty folder to fill, and move it to ``target`` at the end; after an error the old one stays.

    marker: path within such a folder of a file that it always has. Raises a one-line `InputError` if it
    cannot be written, or something else is in its place.
    """
    check_folder(target, marker)
    try:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.") as beside:
            unfinished, earlier = Path(beside, target.name), Path(beside, "earlier")
            unfinished.mkdir()
            yield unfinished
            if target.exists():
                os.replace(target, earlier)
            os.replace(unfinished, target)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}", ALLOWED_FOLDER) from None


def check_folder(target: Path, marker: str) -> Path:
    """The path, if a folder can be written there; raises `InputError` before anything is computed.

    What is in its place, if anything, has to be a folder that is empty or has the file ``marker``.
    """
    with contextlib.suppress(OSError):
        if target.is_dir() and any(target.iterdir()) and not (marker and (target / marker).exists()):
            raise InputError(
                f"cannot write {target}: it is there and is no such export", "allowed: another name"
            )
        if target.exists() and not target.is_dir():
            raise InputError(f"cannot write {target}: it is not a folder", ALLOWED_FOLDER)
    _require_place(target, ALLOWED_FOLDER)
    return target


def _require_file(target: Path) -> None:
    """Raise `InputError` where something other than a file, or one that may not be written, has that path."""
    with contextlib.suppress(OSError):  # such as a name that is too long, which writing reports
        if target.is_dir():
            raise InputError(f"cannot write {target}: it is a folder", ALLOWED)
        if target.exists() and not target.is_file():
            raise InputError(f"cannot write {target}: it is not a regular file", ALLOWED)
        # An administrator may write any file: the mode counts, too.
        if target.exists() and not (os.access(target, os.W_OK) and target.stat().st_mode & WRITABLE):
            raise InputError(f"cannot write {target}: it is write-protected", ALLOWED)


def check_apart(targets: Sequence[Path | None], sources: Sequence[Path]) -> None:
    """Raise `InputError` where an output would replace an input, or two outputs are one file."""
    read = {_place(source) for source in sources}
    written: set[Path] = set()
    for target in filter(None, targets):
        place = _place(target)
        if place in read:
            raise InputError(f"{target} is an input file", "allowed: another name for the output")
        if place in written:
            raise InputError(f"{target} is written twice", "allowed: different names")
        written.add(place)


def _place(path: Path) -> Path:
    with contextlib.suppress(OSError, RuntimeError):  # a loop of links, an unknown home
        return path.expanduser().resolve()
    return path


def _require_place(target: Path, allowed: str) -> None:
    """Raise `InputError` unless something can be written there as it will be: beside it, then renamed."""
    try:
        tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.").cleanup()
    except OSError as error:
        reason = _reason(target) or error.strerror or str(error)
        raise InputError(f"cannot write {target}: {reason}", allowed) from None


def _reason(target: Path) -> str:
    folder = target.parent
    with contextlib.suppress(OSError):
        if not folder.exists():
            return f"the folder {folder} does not exist"
        if not folder.is_dir():
            return f"{folder} is not a folder"
    return ""
