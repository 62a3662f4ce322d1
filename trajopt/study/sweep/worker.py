"""A timed process: ``python -m trajopt.study.sweep.worker CORE``.

It is pinned to one core, loads the library once, and then reads one task a line (JSON) on stdin. Each task
is done by a child made by fork, so that none inherits memory, caches or a crash from another, and answered by
one line: what was found, or how the child was lost. A child that exceeds its time is ended by the kernel
(SIGALRM), in whatever library it is. What libraries print goes to stderr. Worker and child end when stdin is
closed: none outlives the sweep that started it.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import math
import os
import select
import signal
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from trajopt.errors import TrajoptError
from trajopt.study.sweep.cores import pin
from trajopt.study.sweep.result import LOST, REFUSED

Answer = dict[str, Any]
BLOCK = 65536


def main() -> None:
    """Serve tasks until stdin ends."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    faulthandler.enable()
    warnings.simplefilter("ignore")
    pin(int(sys.argv[1]))
    tasks = _preloaded()
    gc.collect()
    gc.freeze()  # a child's collector leaves the parent's pages alone
    for line in sys.stdin:
        out.write(json.dumps(_in_child(json.loads(line), tasks)) + "\n")
        out.flush()


def _preloaded() -> dict[str, Callable[[Mapping[str, Any]], Answer]]:
    """The tasks by kind; all that they need is imported here, once."""
    import scipy.integrate  # noqa: F401 - loaded by the first re-integration otherwise

    from trajopt.study.sweep import tasks

    tasks.families()
    return tasks.KINDS


def _in_child(task: Mapping[str, Any], tasks: Mapping[str, Callable[[Mapping[str, Any]], Answer]]) -> Answer:
    """The answer to a task, from a child of this process."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        _child(task, tasks, write)
    os.close(write)
    told = _told(read, child)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return {"kind": LOST, "detail": _signal_text(os.WTERMSIG(status), float(task["limit"]))}
    if not told:
        return {"kind": LOST, "detail": f"crash: exit status {os.waitstatus_to_exitcode(status)}"}
    answer: Answer = json.loads(told)
    return answer


def _told(read: int, child: int) -> bytes:
    """All that the child writes; the end of both where stdin ends first, for no task is sent meanwhile."""
    told = b""
    while True:
        ready, _, _ = select.select([read, sys.stdin], [], [])
        if sys.stdin in ready:
            os.kill(child, signal.SIGKILL)
            os._exit(1)
        block = os.read(read, BLOCK)
        if not block:
            os.close(read)
            return told
        told += block


def _signal_text(number: int, limit: float) -> str:
    if number == signal.SIGALRM:
        return f"killed after {limit:g} s"
    hint = " (out of memory?)" if number == signal.SIGKILL else ""
    return f"crash: {signal.Signals(number).name}{hint}"


def _child(
    task: Mapping[str, Any], tasks: Mapping[str, Callable[[Mapping[str, Any]], Answer]], write: int
) -> None:
    """Do the task, write its answer, and leave: nothing returns from here."""
    try:
        signal.alarm(max(1, math.ceil(task["limit"])))
        answer = {"kind": "done", **tasks[task["task"]](task)}
    except TrajoptError as error:
        answer = {"kind": REFUSED, "detail": str(error)}
    except MemoryError:
        answer = {"kind": LOST, "detail": "crash: out of memory"}
    except BaseException as error:  # of a family, of a library: told, not lost
        answer = {"kind": LOST, "detail": " ".join(f"crash: {type(error).__name__}: {error}".split())}
    try:
        with os.fdopen(write, "w", encoding="utf-8") as stream:
            stream.write(json.dumps(answer))
    finally:
        os._exit(0)  # at once: what the parent opened is the parent's to close


if __name__ == "__main__":
    main()
