"""The process of one pair: ``python -m trajopt.study.suite.worker``.

Reads one job as a line of JSON on stdin and writes events as lines of JSON on stdout; what libraries print
goes to stderr. It ends when stdin is closed: no worker outlives the suite that started it.
"""

from __future__ import annotations

import faulthandler
import json
import os
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any, TextIO

# Iterations are told at most this often, s: a display needs no more.
PAUSE = 0.2


class Teller:
    """Writes events to a stream, one line each; iterations now and then."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._last = stream, 0.0

    def __call__(self, event: dict[str, Any]) -> None:
        """Write one event."""
        self._stream.write(json.dumps(event) + "\n")
        self._stream.flush()

    def progress(self, figures: dict[str, float]) -> bool:
        """A solver's progress callback: never stops it."""
        now = time.monotonic()
        if now - self._last >= PAUSE:
            self._last = now
            self({"event": "iteration", "iteration": int(figures["iteration"])})
        return True


def _end_with(stream: TextIO) -> None:
    """End the process when ``stream`` is closed."""

    def wait() -> None:
        stream.read()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _own_stdout() -> TextIO:
    """A stream to what was stdout; file descriptor 1 is stderr from now on."""
    kept = os.dup(1)
    os.dup2(2, 1)
    return os.fdopen(kept, "w", encoding="utf-8")


def main() -> None:
    """Run one job; whatever goes wrong is told as an event where the process survives it."""
    faulthandler.enable()
    warnings.simplefilter("ignore")
    tell = Teller(_own_stdout())
    job = json.loads(sys.stdin.readline())
    _end_with(sys.stdin)
    from trajopt.errors import TrajoptError

    try:
        _run(job, tell)
    except TrajoptError as error:
        tell({"event": "failed", "error": f"bad input: {error}"})
    except MemoryError:
        tell({"event": "failed", "error": "crash: out of memory"})
    except Exception as error:  # of a family, of a library: it shall not look like a lost process
        text = " ".join(f"{type(error).__name__}: {error}".split())
        tell({"event": "failed", "error": f"crash: {text}"})
    tell({"event": "end"})
    os._exit(0)  # at once: destructors of libraries have nothing to add


def _run(job: dict[str, Any], tell: Teller) -> None:
    from trajopt.study.suite.cases import Case
    from trajopt.study.suite.run import run
    from trajopt.study.suite.settings import Settings

    run(
        Case(**job["case"]),
        Settings.from_dict(job["settings"]),
        tell,
        own=job["own"],
        seeds=job["seeds"],
        progress=tell.progress,
        folder=None if job["folder"] is None else Path(job["folder"]),
    )


if __name__ == "__main__":
    main()
