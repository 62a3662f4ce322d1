"""Cache entries: files that appear atomically, each with a digest of its content.

An entry is written to a temporary file and renamed, so processes can share the cache. An entry whose content
differs from what was written (a full disk, a crash) counts as missing.
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
    """Return the cache folder: $TRAJOPT_CACHE_DIR, or else the user's cache folder on this platform."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("trajopt", appauthor=False))


def read_entry(name: str) -> bytes | None:
    """Return the content of an entry, or None if it is missing or damaged."""
    try:
        text = (cache_directory() / name).read_bytes()
    except OSError:
        return None
    content = text[_DIGEST:]
    return content if hashlib.sha256(content).digest() == text[:_DIGEST] else None


def write_entry(name: str, content: bytes) -> None:
    """Write an entry; on failure, warn once and continue without it."""
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
