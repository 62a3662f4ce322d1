"""Processes that run tasks: one may crash, hang or run out of memory, and no other task is affected."""

import contextlib
import faulthandler
import fcntl
import gc
import multiprocessing
import os
import pickle
import queue
import select
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

from trajopt.errors import InputError, TrajoptError

_Result = TypeVar("_Result")
# Environment of the server, and thus of all tasks: one thread each, because there is a task per processor,
# and no modules from the working directory.
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYTHONSAFEPATH": "1",
    "PYTHONWARNINGS": "ignore",
}
# Seconds for a process to end, and for an ended server to be replaced.
PATIENCE = 5.0
# `multiprocessing` keeps its children in a set and reads their status once: one thread at a time.
_processes = threading.Lock()
# Kinds of message from a task's process: it has begun, a time limit has started, a result, an error.
BEGUN, LIMIT, DONE, FAILED = "begun", "limit", "done", "failed"
# Outcomes of a task without a value: it cannot have one, it took too long, its process was lost.
REFUSED, TIME_LIMIT, LOST = "refused", "time_limit", "lost"
# Exit status of a worker whose script starts workers when it is imported; no other program ends with it.
UNGUARDED = 213

_answers: Connection | None = None


class TaskError(TrajoptError):
    """A task has no result; the text gives the reason."""

    kind = LOST


class RefusedTaskError(TaskError):
    """The task raised a TrajoptError, and would do so again."""

    kind = REFUSED


class LostTaskError(TaskError):
    """The task raised another exception, or its process ended before it was done."""


class TaskTimeoutError(LostTaskError):
    """The task was ended because of its time limit."""

    kind = TIME_LIMIT


class UnguardedScriptError(InputError, SystemExit):
    """The script of this program starts workers whenever it is imported, and workers import it.

    It ends a script in one line, without a traceback.
    """

    def __init__(self) -> None:
        super().__init__(
            "the script starts workers again where a worker imports it",
            'allowed: start them below `if __name__ == "__main__":`',
        )
        self.code = str(self)


def end_unguarded_import() -> None:
    """End this process if it is a worker that imports the script by which it was started.

    Without a main guard, each worker of a script would start workers.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(UNGUARDED)


def limit_time(seconds: float) -> None:
    """Limit the process of this task to this many seconds from now, in place of any previous limit.

    The kernel ends it (SIGALRM), in whatever library it hangs. Ignored if the task has no separate process.
    """
    if _answers is not None:
        _answers.send((LIMIT, f"killed after {seconds:g} s"))
        signal.setitimer(signal.ITIMER_REAL, seconds)


def serve_tasks(connection: Connection, log: str, core: int | None) -> None:
    """Run pickled ``(function, args, kwargs)`` as they arrive, until the connection is closed.

    log: a file for the output of libraries. core: processor to pin to, if the system supports it.
    """
    global _answers
    os.setsid()  # a group of its own, so that the compilers it starts end with it
    for number in (signal.SIGALRM, signal.SIGIO):  # even if they were ignored: here they end the process
        signal.signal(number, signal.SIG_DFL)
    _end_with_parent()
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    faulthandler.enable()
    gc.freeze()  # keeps the collector from touching pages shared with the server
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    _answers = connection
    with contextlib.suppress(EOFError, OSError):
        while True:
            task = connection.recv_bytes()
            connection.send((BEGUN, ""))
            answer = _answer(task)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            connection.send_bytes(answer)
    os._exit(0)  # at once: skips the destructors of libraries


def _answer(task: bytes) -> bytes:
    try:
        function, args, kwargs = pickle.loads(task)
        return pickle.dumps((DONE, function(*args, **kwargs)))
    except TrajoptError as error:
        failed: TaskError = RefusedTaskError(str(error))
    except MemoryError:
        failed = LostTaskError("crash: out of memory")
    except BaseException as error:  # from a family or a library: must not look like a lost process
        failed = LostTaskError(" ".join(f"crash: {type(error).__name__}: {error}".split()))
    return pickle.dumps((FAILED, failed))


def _end_with_parent() -> None:
    """Have the kernel end the whole group when the waiting process is gone, even if a library hangs.

    Its end of a pipe closes then, which counts as input (SIGIO), whose default action is to end a process.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, -os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([parent.sentinel], [], [], 0)[0]:  # it had already ended
        os._exit(1)


def _forget_server() -> None:
    """Reset the server in a process forked from one that has it, such as a worker of `ProcessPoolExecutor`.

    The server is not a child of this process, which needs its own, and a lock that no thread of its parent
    holds.
    """
    global _processes
    _processes = threading.Lock()
    forkserver._forkserver.__init__()  # type: ignore[misc]


os.register_at_fork(after_in_child=_forget_server)


class _EndedError(Exception):
    """A process that was ended from outside while it waited for a task."""


class _Process:
    """A process that does tasks one after the other: its connection, and the file of its output."""

    def __init__(self, context: multiprocessing.context.ForkServerContext, core: int | None) -> None:
        self.connection, theirs = context.Pipe()
        self.log = tempfile.NamedTemporaryFile()  # noqa: SIM115, closed by `end`
        self.tasks = 0
        self.process = context.Process(target=serve_tasks, args=(theirs, self.log.name, core))
        self.process.daemon = True
        self.close_theirs = theirs.close

    def start(self) -> None:
        """Fork it from the server."""
        _fork(self.process)
        self.close_theirs()

    def answer(self, task: bytes) -> Any:
        """The result of a task, or its TaskError; `_EndedError` if it was ended while it waited."""
        self.tasks += 1
        limit, begun = "", False
        try:
            self.connection.send_bytes(task)
            while True:
                kind, value = self.connection.recv()
                if kind == DONE:
                    return value
                if kind not in (BEGUN, LIMIT):
                    raise value
                limit, begun = value, True
        except (EOFError, OSError):
            if self.tasks > 1 and not begun:
                raise _EndedError from None
            raise _lost(self.process, limit, self.log) from None

    def end(self) -> None:
        """End it and everything that it started."""
        _kill(self.process)
        self.process.join()
        self.connection.close()
        self.log.close()


class ProcessPerTaskExecutor(Executor):
    """Runs each task in a process forked from a server that has all modules loaded.

    With ``most_tasks`` above one, a process whose task returned a result does the next one, up to that
    number, since robots and functions are already loaded.

    A task without a result raises a `TaskError` from its future, and does not affect others:
    `RefusedTaskError` for a TrajoptError, `TaskTimeoutError` beyond its own time limit (`limit_time`),
    `LostTaskError` otherwise. As with other executors, functions and arguments are pickled. Leaving the
    ``with`` block by an exception ends all processes and their children; so does the end of this process. A
    script whose workers would start workers gets an `UnguardedScriptError`.

    Args:
        max_workers: tasks at a time.
        cores: a processor for each of them, to which it is pinned; default: no pinning.
        preload: modules that the server loads if it is not running yet; a process has one server.
        most_tasks: most tasks of one process.
    """

    def __init__(
        self,
        max_workers: int,
        *,
        cores: Sequence[int] = (),
        preload: Sequence[str] = (),
        most_tasks: int = 1,
    ) -> None:
        end_unguarded_import()
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([serve_tasks.__module__, *preload])
        self._threads = ThreadPoolExecutor(max_workers)
        self._most_tasks = most_tasks
        self._living: set[_Process] = set()
        self._cancelled = self._closed = False
        # Places for one task at a time: a processor, and a process that waits for the next task.
        self._places: queue.SimpleQueue[tuple[int | None, _Process | None]] = queue.SimpleQueue()
        for place in range(max_workers):
            self._places.put((cores[place] if cores else None, None))

    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """The future of ``fn(*args, **kwargs)``, called in another process."""
        return self._threads.submit(self._run, pickle.dumps((fn, args, kwargs)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Accept no more tasks; with ``cancel_futures``, end the running ones, too."""
        self._closed = True
        if cancel_futures:
            with _processes:
                self._cancelled = True
                for process in self._living:
                    _kill(process.process)
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            with _processes:
                while self._living:
                    self._living.pop().end()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self.shutdown(cancel_futures=kind is not None)

    def _run(self, task: bytes) -> Any:
        """Run one task to its end, in one of the threads."""
        core, process = self._places.get()
        goes_on = False
        try:
            process = process or self._started(core)
            try:
                result = process.answer(task)
            except _EndedError:
                self._end(process)
                process = None
                process = self._started(core)
                result = process.answer(task)
            goes_on = process.tasks < self._most_tasks and not self._closed
            return result
        finally:
            if process is not None and not goes_on:
                self._end(process)
            self._places.put((core, process if goes_on else None))

    def _started(self, core: int | None) -> _Process:
        process = _Process(self._context, core)
        with _processes:
            if self._cancelled:
                raise CancelledError
            process.start()
            self._living.add(process)
        return process

    def _end(self, process: _Process) -> None:
        with _processes:
            process.end()
            self._living.discard(process)


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _fork(process: ForkServerProcess) -> None:
    """Have the server fork a process; start the server first if it does not run (any more)."""
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


def _lost(process: ForkServerProcess, limit: str, log: IO[bytes]) -> LostTaskError | UnguardedScriptError:
    """The error of a process that ended without a result."""
    with _processes:
        process.join(PATIENCE)
    code = process.exitcode or 0
    if code == UNGUARDED:
        return UnguardedScriptError()
    if code == -signal.SIGALRM:
        return TaskTimeoutError(limit)
    if code < 0:
        hint = " (out of memory?)" if code == -signal.SIGKILL else ""
        return LostTaskError(f"crash: {signal.Signals(-code).name}{hint}")
    words = log.read().decode(errors="replace").strip().splitlines()
    return LostTaskError(f"crash: exit status {code}{': ' + words[-1] if words else ''}")
