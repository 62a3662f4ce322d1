"""Results of a study on disk, to resume from: one line of JSON each, appended at once."""

import json
import platform
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import casadi

from trajopt.errors import InputError
from trajopt.versions import installed_version

UNKNOWN = "unknown"


class JsonLines:
    """A file of JSON objects, one per line; without a path, nothing is stored."""

    def __init__(self, path: Path | None) -> None:
        self.path = path

    def open(self, *, resume: bool) -> list[dict[str, Any]]:
        """Create the folder and the file, which is emptied unless it is resumed; returns its objects.

        Raises `InputError` if it cannot be written, or holds something else.
        """
        if self.path is None:
            return []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a+", encoding="utf-8", errors="replace") as stream:
                stream.seek(0)
                text = stream.read()
                if resume and text and not text.endswith("\n"):  # a line cut off by a crash
                    stream.write("\n")
                elif not resume and text and not text.startswith("{"):
                    reason = "it is there and holds no results"
                    raise InputError(f"cannot write {self.path}: {reason}", "allowed: another folder")
                elif not resume:
                    stream.truncate(0)
        except OSError as error:
            raise InputError(
                f"cannot write {self.path}: {error.strerror or error}",
                "allowed: a folder that can be written",
            ) from None
        return self.read()

    def begin(
        self, kind: str, head: Mapping[str, Any], words: Mapping[str, str], *, resume: bool
    ) -> list[dict[str, Any]]:
        """`open` a file whose first line says what the study is; returns the objects after it.

        Args:
            kind: the study in one word, for messages.
            head: what has to agree for the study to be resumed, JSON-able, by name.
            words: what another study has instead, by name.
            resume: continue with the results in the file.

        Raises:
            InputError: also if there is nothing to resume, or another study.
        """
        if self.path is None:
            return []
        if not resume:
            self.open(resume=False)
            self.append(head)
            return []
        known = self.read() or [{}]
        # Sweeps of earlier versions have it below a name.
        require_same(self.path.parent, kind, known[0].get("head", known[0]), head, words)
        return self.open(resume=True)[1:]

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
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Delete the file."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def require_same(
    folder: Path, kind: str, known: Any, head: Mapping[str, Any], words: Mapping[str, str]
) -> None:
    """Raise `InputError` unless a folder's study is the one that is resumed; see `JsonLines.begin`."""
    if not isinstance(known, Mapping) or not any(name in known for name in words):
        raise InputError(f"{folder} holds no {kind}", f"allowed: the folder of a {kind}")
    for name, text in words.items():
        if known.get(name) != json.loads(json.dumps(head[name])):
            raise InputError(
                f"{folder} holds a {kind} with {text}",
                f"allowed: the same {kind} with `resume`, or another folder",
            )


def versions() -> dict[str, str]:
    """Names and versions; IPOPT is that of CasADi's wheel."""
    return {
        "trajopt": installed_version("trajopt"),
        "casadi": installed_version("casadi"),
        "ipopt": ipopt_version(),
        "pin": installed_version("pin"),
        "numpy": installed_version("numpy"),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def ipopt_version() -> str:
    """The version of IPOPT in CasADi's wheel, from the header next to its library."""
    header = Path(casadi.__file__).parent / "include" / "coin-or" / "IpoptConfig.h"
    try:
        match = re.search(r'#define IPOPT_VERSION "([^"]+)"', header.read_text(encoding="utf-8"))
    except OSError:
        match = None
    return match[1] if match else UNKNOWN
