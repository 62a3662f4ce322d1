"""Entries of the cache: files that appear whole, each with a digest of its content.

An entry is written to a temporary file and renamed, so that processes may share the cache. One whose content
is not what was written (a full disk, a crash) does not count as an entry.
"""

import contextlib
import hashlib
import os
import uuid
import warnings
from functools import cache
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "TRAJOPT_CACHE_DIR"
_DIGEST = hashlib.sha256().digest_size


def cache_directory() -> Path:
    """The cache's folder: $TRAJOPT_CACHE_DIR, or the user's cache folder of this platform."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("trajopt", appauthor=False))


def read_entry(name: str) -> bytes | None:
    """An entry's content; None where there is no entry, or a damaged one."""
    try:
        text = (cache_directory() / name).read_bytes()
    except OSError:
        return None
    content = text[_DIGEST:]
    return content if hashlib.sha256(content).digest() == text[:_DIGEST] else None


def write_entry(name: str, content: bytes) -> None:
    """Write an entry; where that is not possible all works without it, and a warning says so once."""
    folder = cache_directory()
    unfinished = folder / f".{name}.{uuid.uuid4().hex}"
    try:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            unfinished.write_bytes(hashlib.sha256(content).digest() + content)
            unfinished.replace(folder / name)
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
    except OSError as error:
        _warn(folder, str(error.strerror))


@cache
def _warn(folder: Path, reason: str) -> None:
    warnings.warn(
        f"the cache folder {folder} cannot be written ({reason}): nothing is kept for the next time;"
        f" {CACHE_VARIABLE} names another one",
        stacklevel=3,
    )
