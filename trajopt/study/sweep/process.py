"""Workers seen from the sweep: one pinned process a core, tasks in, answers out."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

from trajopt.solving.interruption import LOOK
from trajopt.study.suite.process import ONE_THREAD
from trajopt.study.sweep.result import LOST

Task = Mapping[str, Any]
Answer = dict[str, Any]


class Worker:
    """One process, started when it is first asked, and again after it was lost."""

    def __init__(self, core: int) -> None:
        self._core = core
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._closed = False

    def ask(self, task: Task) -> Answer:
        """The answer to a task; of kind `LOST` where the process itself ended."""
        process = self._running()
        if process is None:
            return {"kind": LOST, "detail": "cancelled"}
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it is gone: its end is read below
            process.stdin.write(json.dumps(task).encode() + b"\n")
            process.stdin.flush()
        line = process.stdout.readline()
        if line.endswith(b"\n"):
            answer: Answer = json.loads(line)
            return answer
        said = self._end()
        return {"kind": LOST, "detail": f"crash of the worker{said}"}

    def close(self) -> None:
        """End the process and all that it started; a task that it is at is lost."""
        with self._lock:
            self._closed = True
            if self._process is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()

    def _running(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._closed:
                return None
            if self._process is None:
                self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
                path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "trajopt.sweep.worker", str(self._core)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._errors,
                    env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
                    start_new_session=True,
                )
            return self._process

    def _end(self) -> str:
        """What a lost process said last; the next task starts another."""
        with self._lock:
            process, self._process = self._process, None
        if process is None:
            return ""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(BrokenPipeError):
                if stream is not None:
                    stream.close()
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").strip().splitlines()
        return f": {said[-1]}" if said else ""


class Pool:
    """Workers on their cores; tasks are given to free ones, answers taken as they come.

    Leaving it ends all processes. check: called several times a second while an answer is waited for, which
    ends with what it raises.
    """

    def __init__(self, cores: Sequence[int], check: Callable[[], object] = bool) -> None:
        self._check = check
        self._workers = [Worker(core) for core in cores]
        self._answers: queue.Queue[tuple[int, Any, Answer]] = queue.Queue()
        self._free = list(range(len(cores)))[::-1]

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.close()

    @property
    def has_free(self) -> bool:
        """Whether a worker waits for a task."""
        return bool(self._free)

    @property
    def is_busy(self) -> bool:
        """Whether an answer is to come."""
        return len(self._free) < len(self._workers)

    def start(self, label: Any, task: Task) -> None:
        """Give a task to a free worker; ``label`` comes back with its answer."""
        slot = self._free.pop()

        def serve() -> None:
            self._answers.put((slot, label, self._workers[slot].ask(task)))

        threading.Thread(target=serve, daemon=True).start()

    def take(self) -> tuple[Any, Answer]:
        """The next answer and the label of its task; waits for it."""
        while True:
            self._check()
            with contextlib.suppress(queue.Empty):
                slot, label, answer = self._answers.get(timeout=LOOK)
                self._free.append(slot)
                return label, answer

    def ask(self, task: Task) -> Answer:
        """One task while nothing else runs."""
        self.start(None, task)
        return self.take()[1]
