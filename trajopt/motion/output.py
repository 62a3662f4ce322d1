"""Output files: paths are checked before any computation, and files are written completely or not at all."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from trajopt.errors import InputError, expanded

ALLOWED = "allowed: a file in an existing folder that can be written"
ALLOWED_FOLDER = "allowed: a new name in an existing folder that can be written"
# Mode bits that allow writing.
WRITE_BITS = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
# First bytes of a solution file.
ARCHIVE = b"PK"


def check_output(path: Path) -> Path:
    """Return the path if a file can be written there, else raise `InputError`."""
    target = expanded(path)
    _require_file(target)
    _require_place(target, ALLOWED)
    return target


def require_ending(path: Path, ending: str) -> None:
    """Raise `InputError` unless a file's name has the given ending."""
    if path.suffix.lower() != ending:
        raise InputError(f"the name of {path} does not end with {ending}", f"allowed: NAME{ending}")


def check_solution_output(path: Path) -> Path:
    """Check the path of a solution file (.npz) as `check_output`; other files are not overwritten."""
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
    """Provide a temporary file that replaces ``target`` at the end; after an error the old file remains.

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
    """Provide an empty folder that replaces ``target`` at the end; after an error the old one remains.

    ``marker`` is the relative path of a file that every such folder contains. Raises a one-line `InputError`
    if the folder cannot be written, or something else is at ``target``.
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
    """Return the path if a folder can be written there, else raise `InputError`.

    An existing folder must be empty or contain the file ``marker``.
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
    """Raise `InputError` if the path exists and is not a file that may be written."""
    with contextlib.suppress(OSError):  # for example, a name that is too long: writing reports it
        if target.is_dir():
            raise InputError(f"cannot write {target}: it is a folder", ALLOWED)
        if target.exists() and not target.is_file():
            raise InputError(f"cannot write {target}: it is not a regular file", ALLOWED)
        # The superuser has access to any file, so the mode is checked as well.
        if target.exists() and not (os.access(target, os.W_OK) and target.stat().st_mode & WRITE_BITS):
            raise InputError(f"cannot write {target}: it is write-protected", ALLOWED)


def check_apart(targets: Sequence[Path | None], sources: Sequence[Path]) -> None:
    """Raise `InputError` if an output would replace an input, or two outputs are the same file."""
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
    with contextlib.suppress(OSError, RuntimeError):  # a loop of links, or an unknown home folder
        return path.expanduser().resolve()
    return path


def _require_place(target: Path, allowed: str) -> None:
    """Raise `InputError` unless a file can be created beside the target and renamed."""
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
