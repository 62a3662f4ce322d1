"""The loop of all studies: tasks go to an executor, and what became of them is yielded as they end."""

import functools
import multiprocessing
import os
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from trajopt.errors import InputError
from trajopt.problem.catalogue import problem_modules
from trajopt.study.workers.executor import ProcessPerTaskExecutor
from trajopt.study.workers.task import (
    LostTaskError,
    RefusedTaskError,
    TaskError,
    TaskTimeoutError,
    UnguardedScriptError,
    limit_time,
)

# Seconds between two calls of ``check`` during a wait.
LOOK = 0.1
# Tasks that one process does: robots and functions are loaded for the first of them.
MOST_TASKS = 50
# What became of a task: it has a value; it cannot have one; it took too long; its process was lost; it was
# not begun.
DONE, REFUSED, TIME_LIMIT, LOST, NOT_RUN = "done", "refused", "time_limit", "lost", "not_run"

Key = TypeVar("Key")


class NotRunError(TaskError):
    """A task that is not begun, because of what became of others."""


@dataclass(frozen=True, kw_only=True)
class TimedCall:
    """A picklable function with its arguments and its time limit, s. ``name``: for a display."""

    name: str
    limit: float
    function: Callable[..., Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Ended(Generic[Key]):
    """What became of a task: its value if it is `DONE`, else the reason in ``detail``."""

    key: Key
    name: str
    kind: str = DONE
    value: Any = None
    detail: str = ""
    attempts: int = 1


def run_tasks(
    waiting: deque[Key],
    make: Callable[[Key], TimedCall],
    executor: Executor,
    *,
    window: Callable[[], int],
    attempts: int = 1,
    check: Callable[[], object] = bool,
    show: Callable[[Collection[str]], object] = len,
) -> Iterator[Ended[Key]]:
    """Run tasks, and those that the caller appends meanwhile; yield each as it ends.

    Args:
        waiting: keys of tasks; the caller may change it between two results.
        make: the task of a key, called when it is begun; one that raises a `TaskError` has ended with it.
        executor: any; one that is not of processes of their own starts such processes on its workers.
        window: most tasks that it has at a time: more wait here.
        attempts: a task whose process is lost is run again, up to so many times in all.
        check: called several times a second; an exception from it ends the run.
        show: called as often with the names of the tasks that run.

    Raises:
        InputError: where the executor has broken down, or the script lacks its main guard.
    """
    run = limited if isinstance(executor, ProcessPerTaskExecutor) else limited_anywhere
    running: dict[Future[Any], tuple[Key, str]] = {}
    tried = Counter[Key]()
    while waiting or running:
        while waiting and len(running) < max(1, window()):
            key = waiting.popleft()
            tried[key] += 1
            try:
                task = make(key)
            except TaskError as error:
                yield Ended(key=key, name="", kind=_kind(error), detail=_text(error))
                continue
            try:
                future = executor.submit(run, task.limit, task.function, *task.args)
            except (BrokenExecutor, RuntimeError) as error:
                check()
                raise _broken(error) from None
            running[future] = key, task.name
        check()
        ended = wait(running, timeout=LOOK, return_when=FIRST_COMPLETED).done
        show([name for future, (_, name) in running.items() if future.running()])
        for future in [future for future in running if future in ended]:  # in the order of submission
            key, name = running.pop(future)
            try:
                result = _ended(future, key, name, tried[key])
            except (BrokenExecutor, CancelledError) as error:
                check()
                raise _broken(error) from None
            if (
                result.kind == LOST
                and tried[key] < attempts
                and isinstance(future.exception(), LostTaskError)
            ):
                waiting.append(key)
            else:
                yield result


def limited(seconds: float, function: Callable[..., Any], *args: Any) -> Any:
    """The result of a function, as a task whose process ends after so many seconds."""
    limit_time(seconds)
    return function(*args)


def limited_anywhere(seconds: float, function: Callable[..., Any], *args: Any) -> Any:
    """`limited` in a process that this worker of any executor starts for it.

    A task that crashes, hangs or runs out of memory does not take the worker with it. Raises a `TaskError`.
    """
    # Daemonic processes, as the workers that Dask's nannies start, may have no children because these would
    # not end with their parent; ours do.
    getattr(multiprocessing.current_process(), "_config", {}).pop("daemon", None)
    return _processes(os.getpid()).submit(limited, seconds, function, *args).result()


def local_executor(jobs: int) -> ProcessPerTaskExecutor:
    """Processes on this machine, so many at a time, with the modules of all studies loaded."""
    studies = (f"trajopt.study.{name}" for name in ("batch.solved_case", "suite.run", "sweep.run"))
    return ProcessPerTaskExecutor(jobs, preload=(*problem_modules(), *studies), most_tasks=MOST_TASKS)


@functools.cache
def _processes(worker: int) -> ProcessPerTaskExecutor:
    """The processes of the worker with that process id; as many at a time as the worker has tasks.

    A worker that is forked from another does not have its threads.
    """
    return local_executor(os.cpu_count() or 1)


def _ended(future: Future[Any], key: Key, name: str, attempts: int) -> Ended[Key]:
    try:
        return Ended(key=key, name=name, value=future.result(), attempts=attempts)
    except (BrokenExecutor, CancelledError, UnguardedScriptError):
        raise
    except Exception as error:  # of the task, or of the executor: a worker that was lost too often
        return Ended(key=key, name=name, kind=_kind(error), detail=_text(error), attempts=attempts)


def _kind(error: Exception) -> str:
    kinds: dict[type[Exception], str] = {
        RefusedTaskError: REFUSED,
        TaskTimeoutError: TIME_LIMIT,
        NotRunError: NOT_RUN,
    }
    return kinds.get(type(error), LOST)


def _text(error: BaseException) -> str:
    return " ".join(f"{error}".split()) or type(error).__name__


def _broken(error: BaseException) -> InputError:
    return InputError(
        f"the executor has broken down: {_text(error)}", "what was reported is kept; go on with --resume"
    )
