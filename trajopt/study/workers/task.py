"""The process that runs tasks: their time limits, and how they end."""

import contextlib
import faulthandler
import fcntl
import gc
import multiprocessing
import os
import pickle
import select
import signal
from multiprocessing.connection import Connection

from trajopt.errors import InputError, TrajoptError

# Kinds of message from a task's process: it has begun, a time limit has started, a result, an error.
BEGUN, LIMIT, DONE, FAILED = "begun", "limit", "done", "failed"
# Exit status of a worker whose script starts workers when it is imported; no other program ends with it.
UNGUARDED = 213

_answers: Connection | None = None


class TaskError(TrajoptError):
    """A task has no result; the text gives the reason."""


class RefusedTaskError(TaskError):
    """The task raised a TrajoptError, and would do so again."""


class LostTaskError(TaskError):
    """The task raised another exception, or its process ended before it was done."""


class TaskTimeoutError(LostTaskError):
    """The task was ended because of its time limit."""


class UnguardedScriptError(InputError):
    """The script of this program starts workers whenever it is imported, and workers import it."""

    def __init__(self) -> None:
        super().__init__(
            "the script starts workers again where a worker imports it",
            'allowed: start them below `if __name__ == "__main__":`',
        )


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


def serve_tasks(connection: Connection, said: str, core: int | None) -> None:
    """Run pickled ``(function, args, kwargs)`` as they arrive, until the connection is closed.

    said: a file for the output of libraries. core: processor to pin to, if the system supports it.
    """
    global _answers
    os.setsid()  # a group of its own, so that the compilers it starts end with it
    for number in (signal.SIGALRM, signal.SIGIO):  # even if they were ignored: here they end the process
        signal.signal(number, signal.SIG_DFL)
    _end_with_parent()
    output = os.open(said, os.O_WRONLY | os.O_APPEND)
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
