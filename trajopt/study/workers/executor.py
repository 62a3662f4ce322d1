"""An executor whose tasks may crash, hang or run out of memory: each has a separate process."""

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from typing import IO, Any, TypeVar

from trajopt.study.workers.task import DONE, LIMIT, LostTaskError, TaskTimeoutError, serve_task

_Result = TypeVar("_Result")
# Environment of the server, and so of all tasks: one thread each, because there is a task per processor, and
# no modules from the working directory.
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYTHONSAFEPATH": "1",
    "PYTHONWARNINGS": "ignore",
}
# Seconds that a process may take to end, and an ended server to be replaced.
PATIENCE = 5.0
# `multiprocessing` keeps its children in a set and reads their status once: one thread at a time.
_processes = threading.Lock()


def _forget_server() -> None:
    """In a process that was forked from one with a server, such as a worker of `ProcessPoolExecutor`.

    The server is no child of it: it needs another one, and a lock that no thread of its parent holds.
    """
    global _processes
    _processes = threading.Lock()
    forkserver._forkserver.__init__()  # type: ignore[misc]


os.register_at_fork(after_in_child=_forget_server)


class ProcessPerTaskExecutor(Executor):
    """Runs each task in a process that is forked for it from a server with all modules loaded.

    A task without a result raises a `TaskError` from its future, and does not affect others:
    `RefusedTaskError` for a TrajoptError, `TaskTimeoutError` beyond its own time limit
    (`trajopt.study.workers.task`), `LostTaskError` otherwise. As with other executors functions and arguments
    are pickled. Leaving the ``with`` block by an exception ends all processes and their children; so does the
    end of this process.

    Args:
        max_workers: tasks at a time.
        cores: a processor for each of them, to which it is pinned; default: none is.
        preload: modules that the server loads, where it does not run yet; there is one server in a process.
    """

    def __init__(
        self,
        max_workers: int,
        *,
        cores: Sequence[int] = (),
        preload: Sequence[str] = (),
    ) -> None:
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([serve_task.__module__, *preload])
        self._threads = ThreadPoolExecutor(max_workers)
        self._running: set[ForkServerProcess] = set()
        self._cancelled = False
        self._cores: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        for place in range(max_workers):
            self._cores.put(cores[place] if cores else None)

    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """The future of ``fn(*args, **kwargs)``, called in another process."""
        return self._threads.submit(self._run, pickle.dumps((fn, args, kwargs)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; with ``cancel_futures`` end those that run, too."""
        if cancel_futures:
            with _processes:
                self._cancelled = True
                for process in self._running:
                    _kill(process)
        self._threads.shutdown(wait, cancel_futures=cancel_futures)

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self.shutdown(cancel_futures=kind is not None)

    def _run(self, task: bytes) -> Any:
        """Run one task to its end, in one of the threads."""
        core = self._cores.get()
        try:
            receiver, sender = self._context.Pipe(duplex=False)
            with receiver, tempfile.NamedTemporaryFile() as said:
                process = self._context.Process(target=serve_task, args=(sender, said.name, core, task))
                with sender:
                    self._start(process)
                try:
                    return self._answer(process, receiver, said)
                finally:
                    self._end(process)
        finally:
            self._cores.put(core)

    def _start(self, process: ForkServerProcess) -> None:
        process.daemon = True
        with _processes:
            if self._cancelled:
                raise CancelledError
            _fork(process)
            self._running.add(process)

    def _end(self, process: ForkServerProcess) -> None:
        with _processes:
            _kill(process)
            process.join()
            self._running.discard(process)

    def _answer(self, process: ForkServerProcess, receiver: Connection, said: IO[bytes]) -> Any:
        """The result of a task, or its TaskError."""
        limit = ""
        while True:
            try:
                kind, value = receiver.recv()
            except (EOFError, OSError):
                raise _lost(process, limit, said) from None
            if kind == DONE:
                return value
            if kind != LIMIT:
                raise value
            limit = value


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _fork(process: ForkServerProcess) -> None:
    """Have the server fork a process, starting it first where it does not run (any more)."""
    deadline = time.monotonic() + PATIENCE
    while True:
        resource_tracker.ensure_running()  # starting it later would undo the next line
        # Only the waiting process handles Ctrl-C, not the server or its tasks.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        with _environment(ENVIRONMENT):
            forkserver.ensure_running()
        try:
            process.start()
            return
        except (EOFError, ConnectionError) as error:  # the server has just ended
            if time.monotonic() > deadline:
                raise LostTaskError(f"crash: no process can be started: {error}") from None
            time.sleep(0.05)


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set these environment variables within the block."""
    kept = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            del os.environ[name]
        os.environ.update({name: kept[name] for name in values if name in kept})


def _kill(process: ForkServerProcess) -> None:
    """End a process, and its group if it already has one."""
    process.kill()
    if process.pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _lost(process: ForkServerProcess, limit: str, said: IO[bytes]) -> LostTaskError:
    """The error of a process that ended without a result."""
    with _processes:
        process.join(PATIENCE)
    code = process.exitcode or 0
    if code == -signal.SIGALRM:
        return TaskTimeoutError(limit)
    if code < 0:
        hint = " (out of memory?)" if code == -signal.SIGKILL else ""
        return LostTaskError(f"crash: {signal.Signals(-code).name}{hint}")
    words = said.read().decode(errors="replace").strip().splitlines()
    return LostTaskError(f"crash: exit status {code}{': ' + words[-1] if words else ''}")
