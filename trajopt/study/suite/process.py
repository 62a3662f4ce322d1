"""A worker seen from the suite: its events, the time it may be silent, and how it ended."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from trajopt.solving.monitoring import GRACE
from trajopt.study.suite.failure import ERROR, TIME
from trajopt.study.suite.settings import Settings

# One thread a worker: there is a worker for each processor.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# Seconds between two looks at whether the suite was cancelled.
LOOK = 0.2
BLOCK = 65536


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Seconds that a stage may take before its process is killed.

    build: transcription and the C compiler on a busy machine, an order of magnitude above what the largest
    robots take. physics: MuJoCo's model and its run. grace: over the solver's own time limit, which it checks
    between steps.
    """

    build: float = 600.0
    check: float = 300.0
    physics: float = 300.0
    grace: float = GRACE

    def of(self, stage: str, settings: Settings) -> float:
        """The limit of a stage: ``build``, ``check``, ``physics``, or a solve (``own``, ``start``)."""
        fixed = {"build": self.build, "check": self.check, "physics": self.physics}
        return fixed.get(stage, settings.max_time + self.grace)


class LostError(Exception):
    """A worker was killed because of its time limit, or ended before its job was done."""

    def __init__(self, mode: str, text: str) -> None:
        self.mode, self.text = mode, text
        super().__init__(text)


class Worker:
    """One process with one job. It leads a process group, so that its C compilers end with it."""

    def __init__(self, job: Mapping[str, Any]) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by kill()
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "trajopt.study.suite.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._out = self._process.stdout.fileno()
        with contextlib.suppress(BrokenPipeError):  # it is gone already: its end will be read
            self._process.stdin.write(json.dumps(job).encode() + b"\n")
            self._process.stdin.flush()

    def kill(self) -> None:
        """End the process and all that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def events(self, settings: Settings, limits: Limits) -> Iterator[dict[str, Any] | None]:
        """Events as they come, None now and then while there is none. Raises LostError."""
        stage, begin, rest = "build", time.monotonic(), b""
        while True:
            if not select.select([self._out], [], [], LOOK)[0]:
                limit = limits.of(stage, settings)
                if time.monotonic() - begin > limit:
                    raise LostError(TIME, f"{stage} killed after {limit:g} s")
                yield None
                continue
            data = os.read(self._out, BLOCK)
            if not data:
                raise LostError(ERROR, self._end())
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                event = json.loads(line)
                if event["event"] == "stage":
                    stage, begin = event["stage"], time.monotonic()
                if event["event"] == "end":
                    return
                if event["event"] == "failed":
                    raise LostError(ERROR, event["error"])
                yield event

    def _end(self) -> str:
        """How a process ended that told no end."""
        code = self._process.wait()
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").strip().splitlines()
        if code < 0:
            name = signal.Signals(-code).name
            hint = " (out of memory?)" if -code == signal.SIGKILL else ""
            return f"crash: {name}{hint}"
        return f"crash: exit status {code}{': ' + said[-1] if said else ''}"
