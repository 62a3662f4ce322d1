"""Results on disk, to resume from: one line of JSON each, appended at once."""

import json
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from trajopt.errors import InputError


class JsonLines:
    """A file of JSON objects, one per line; without a path, nothing is stored. Any thread may append.

    Raises InputError if it cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._lock = threading.Lock()

    def open(self, *, resume: bool) -> list[dict[str, Any]]:
        """Create the folder, and the file unless it is resumed; returns its objects."""
        if self.path is None:
            return []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if not resume and not self._is_own():
                raise InputError(
                    f"cannot write {self.path}: it is there and holds no results", "allowed: another folder"
                )
            with self.path.open("a+" if resume else "w+", encoding="utf-8") as stream:
                stream.seek(0)
                text = stream.read()
                if text and not text.endswith("\n"):  # a line cut off by a crash
                    stream.write("\n")
        except OSError as error:
            reason = error.strerror or error
            raise InputError(
                f"cannot write {self.path}: {reason}", "allowed: a folder that can be written"
            ) from None
        return self.read()

    def _is_own(self) -> bool:
        """Whether there is no file yet, an empty one, or one whose first line is a JSON object."""
        if self.path is None or not self.path.is_file():
            return True
        with self.path.open(encoding="utf-8", errors="replace") as stream:
            first = stream.readline()
        return not first or first.startswith("{")

    def read(self) -> list[dict[str, Any]]:
        """All objects; invalid lines are skipped, so their results are computed again."""
        if self.path is None or not self.path.is_file():
            return []
        entries = []
        for line in self.path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):
                entries.append(json.loads(line))
        return [entry for entry in entries if isinstance(entry, dict)]

    def append(self, entry: Mapping[str, Any]) -> None:
        """Write one object."""
        if self.path is not None:
            with self._lock, self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Delete the file."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
