"""The process of a task: what it may tell the one that waits, and how it ends."""

from __future__ import annotations

import faulthandler
import fcntl
import gc
import multiprocessing
import os
import pickle
import select
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from trajopt.errors import TrajoptError

# What a task's process sends: something told, a limit that begins, the result, why there is none.
EVENT, LIMIT, DONE, FAILED = "event", "limit", "done", "failed"

_Result = TypeVar("_Result")
_answers: Connection | None = None


class TaskError(TrajoptError):
    """A task has no result; the text says why."""


class RefusedTaskError(TaskError):
    """The task raised a TrajoptError: it would do so again."""


class LostTaskError(TaskError):
    """The task raised another exception, or its process ended before it was done."""


class TaskTimeoutError(LostTaskError):
    """The task was ended because of its time limit."""


def tell(event: Any) -> None:
    """Hand something to the executor's ``on_event``; nowhere where the task has no process of its own."""
    if _answers is not None:
        _answers.send((EVENT, event))


def limit_time(seconds: float, stage: str = "") -> None:
    """Give this task's process so many seconds from now, in place of the limit before.

    The kernel ends it (SIGALRM), in whatever library it hangs. Nothing where the task has no process of its
    own.
    """
    if _answers is not None:
        _answers.send((LIMIT, f"{stage} killed after {seconds:g} s".lstrip()))
        signal.setitimer(signal.ITIMER_REAL, seconds)


def announced(name: str, seconds: float, function: Callable[..., _Result], *args: Any) -> _Result:
    """The result of a function, as a task that tells its name first and may take so many seconds."""
    tell(name)
    limit_time(seconds)
    return function(*args)


def serve_task(answers: Connection, said: str, core: int | None, task: bytes) -> None:
    """Do a pickled ``(function, args, kwargs)`` as the only task of this process.

    said: a file for what libraries print. core: the processor it is pinned to, where the system can.
    """
    global _answers
    os.setsid()  # a group of its own, so that the compilers it starts end with it
    for number in (signal.SIGALRM, signal.SIGIO):  # whoever ignores them: here they end the process
        signal.signal(number, signal.SIG_DFL)
    _end_with_parent()
    output = os.open(said, os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    faulthandler.enable()
    gc.freeze()  # the collector leaves the pages alone that are shared with the server
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    _answers = answers
    answers.send_bytes(_answer(task))
    os._exit(0)  # at once: destructors of libraries have nothing to add


def _answer(task: bytes) -> bytes:
    try:
        function, args, kwargs = pickle.loads(task)
        return pickle.dumps((DONE, function(*args, **kwargs)))
    except TrajoptError as error:
        failed: TaskError = RefusedTaskError(str(error))
    except MemoryError:
        failed = LostTaskError("crash: out of memory")
    except BaseException as error:  # of a family, of a library: it shall not look like a lost process
        failed = LostTaskError(" ".join(f"crash: {type(error).__name__}: {error}".split()))
    return pickle.dumps((FAILED, failed))


def _end_with_parent() -> None:
    """Have the kernel end the whole group when the waiting process is gone, even where a library hangs.

    Then its end of a pipe closes, which is input (SIGIO), whose default is to end a process.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, -os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([parent.sentinel], [], [], 0)[0]:  # it was gone before
        os._exit(1)
