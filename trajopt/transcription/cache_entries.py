"""Entries of the cache: folders that appear whole, with the digests of their files.

An entry is written to a temporary folder and renamed, so that processes may share the cache. One whose files
are not those that were written (a full disk, a crash) does not count as an entry: a truncated library would
crash the process that loads it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import uuid
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "TRAJOPT_CACHE_DIR"
ENTRY = "entry.json"


def cache_directory() -> Path:
    """The cache's folder: $TRAJOPT_CACHE_DIR, or the user's cache folder of this platform."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("trajopt", appauthor=False))


def intact(entry: Path) -> bool:
    """Whether an entry exists, with exactly the files that were written."""
    try:
        files = json.loads((entry / ENTRY).read_text(encoding="utf-8"))["files"]
        return all(_digest(entry / name) == digest for name, digest in files.items())
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False


def c_bytes(entry: Path) -> int:
    """Size of the C that an entry was compiled from."""
    return int(json.loads((entry / ENTRY).read_text(encoding="utf-8"))["c_bytes"])


class EntryWriter:
    """An entry being written, in ``temporary`` until `move_into_place`."""

    def __init__(self, final: Path, point: str, level: str, beside: Path | None = None) -> None:
        """beside: folder of the temporary one, in the file system of the cache; default: the cache."""
        self.final = final
        self.temporary = (beside or final.parent) / f".{final.name}.{uuid.uuid4().hex}"
        self._entry: dict[str, object] = {"point": point, "level": level}

    def open(self) -> None:
        """Make the temporary folder; raises OSError."""
        self.temporary.mkdir(mode=0o700, parents=True)

    def move_into_place(self, c_bytes: int) -> None:
        """Describe what was written, without the C, and give the entry its name; raises OSError."""
        for source in self.temporary.glob("*.c"):
            source.unlink()
        files = {file.name: _digest(file) for file in self.temporary.iterdir()}
        text = json.dumps(self._entry | {"c_bytes": c_bytes, "files": files})
        (self.temporary / ENTRY).write_text(text, encoding="utf-8")
        if self.final.exists() and not intact(self.final):
            self._set_aside()
        with contextlib.suppress(OSError):  # another process was first: its entry serves as well
            self.temporary.rename(self.final)

    def discard(self) -> None:
        """Remove files that were not moved into place."""
        shutil.rmtree(self.temporary, ignore_errors=True)

    def _set_aside(self) -> None:
        """Move a damaged entry aside; a process that has loaded it keeps its own view of the files."""
        aside = Path(tempfile.mkdtemp(prefix=f".{self.final.name}.", dir=self.final.parent))
        with contextlib.suppress(OSError):  # another process moved it
            self.final.rename(aside / "damaged")
        shutil.rmtree(aside, ignore_errors=True)


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
