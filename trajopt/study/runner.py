"""The loop of all studies: tasks go to an executor, and their outcomes are yielded as they end."""

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
# Most tasks per process: only the first has to load robots and functions.
MOST_TASKS = 50
# Outcomes of a task: it has a value; it cannot have one; it took too long; its process was lost; it was not
# started.
DONE, REFUSED, TIME_LIMIT, LOST, NOT_RUN = "done", "refused", "time_limit", "lost", "not_run"

Key = TypeVar("Key")


class NotRunError(TaskError):
    """A task that is not started because of the outcome of others."""


@dataclass(frozen=True, kw_only=True)
class TimedCall:
    """A picklable function with its arguments and its time limit, s; ``name`` is for a display."""

    name: str
    limit: float
    function: Callable[..., Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Ended(Generic[Key]):
    """Outcome of a task: its value if it is `DONE`, else the reason in ``detail``."""

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
    """Run tasks, including those that the caller appends meanwhile; yield each as it ends.

    Args:
        waiting: keys of tasks; the caller may change it between two results.
        make: returns the task of a key when it is started; a `TaskError` that it raises is the outcome.
        executor: any; unless it is a `ProcessPerTaskExecutor`, its workers start processes for the tasks.
        window: most tasks to submit at a time; others wait here.
        attempts: most times that a task is run if its process is lost.
        check: called several times a second; an exception from it ends the run.
        show: called as often with the names of the running tasks.

    Raises:
        InputError: if the executor breaks down, or the script lacks its main guard.
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
    """Run a function in a task whose process ends after this many seconds."""
    limit_time(seconds)
    return function(*args)


def limited_anywhere(seconds: float, function: Callable[..., Any], *args: Any) -> Any:
    """`limited` in a process that this worker of any executor starts for it.

    A task that crashes, hangs or runs out of memory does not take the worker with it. Raises a `TaskError`.
    """
    # Daemonic processes, such as workers that Dask's nannies start, may have no children, because these might
    # outlive their parent; ours do not.
    getattr(multiprocessing.current_process(), "_config", {}).pop("daemon", None)
    return _processes(os.getpid()).submit(limited, seconds, function, *args).result()


def local_executor(jobs: int) -> ProcessPerTaskExecutor:
    """An executor with this many processes on this machine, and the modules of all studies loaded."""
    studies = (f"trajopt.study.{name}" for name in ("batch.solved_case", "suite.run", "sweep.run"))
    return ProcessPerTaskExecutor(jobs, preload=(*problem_modules(), *studies), most_tasks=MOST_TASKS)


@functools.cache
def _processes(worker: int) -> ProcessPerTaskExecutor:
    """The executor of the worker with that process id, with at most one task per processor.

    A worker that is forked from another does not have its threads.
    """
    return local_executor(os.cpu_count() or 1)


def _ended(future: Future[Any], key: Key, name: str, attempts: int) -> Ended[Key]:
    try:
        return Ended(key=key, name=name, value=future.result(), attempts=attempts)
    except (BrokenExecutor, CancelledError, UnguardedScriptError):
        raise
    except Exception as error:  # from the task, or the executor: a worker was lost too often
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
