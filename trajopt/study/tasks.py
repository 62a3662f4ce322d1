"""The loop of all studies: tasks go to workers, and their outcomes are yielded as they end.

Workers are processes of this machine, those of a given executor, or those of a running Dask cluster.
"""

import functools
import logging
import multiprocessing
import os
import re
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from trajopt.errors import InputError
from trajopt.problem.catalogue import problem_modules
from trajopt.study.processes import (
    DONE,
    LOST,
    LostTaskError,
    ProcessPerTaskExecutor,
    TaskError,
    UnguardedScriptError,
    limit_time,
    processors,
)
from trajopt.versions import optional_package

# Seconds between two calls of a check during a wait.
LOOK = 0.1
# Most tasks per process: only the first has to load robots and functions.
MOST_TASKS = 50
# Outcome of a task that was not started.
NOT_RUN = "not_run"
# Tasks submitted at a time: per process on this machine, and to an executor that does not report its number
# of workers.
TASKS_PER_PROCESS, MOST_SUBMITTED = 2, 1000
# Tasks submitted at a time per thread of Dask's workers, so that none waits for the next one, and their least
# number while workers join.
TASKS_PER_THREAD, LEAST_SUBMITTED = 3, 8
# Seconds after which Dask's workers are counted again.
COUNT_PERIOD = 5.0
# Seconds within which a Dask scheduler has to answer.
DASK_PATIENCE = 10.0
CONNECTED = "running"
ADDRESS, LAST_PORT = r"(?:(?:tcp|tls)://)?(?:\[[^\]\s]+\]|[^\s:/\[\]]+):([0-9]{1,5})", 65535
ADDRESS_FORM = "allowed: tcp://HOST:PORT of a Dask scheduler"
KEPT = "what was reported is kept; go on with `resume`"

Key = TypeVar("Key")


class NotRunError(TaskError):
    """A task that is not started because of the outcome of others."""

    kind = NOT_RUN


@dataclass(frozen=True, kw_only=True)
class TimedCall:
    """A picklable function with its arguments and its time limit, s; ``name`` is for a display."""

    name: str
    limit: float
    function: Callable[..., Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Ended(Generic[Key]):
    """Outcome of a task: its value if its kind is `DONE`, else the reason in ``detail``."""

    key: Key
    name: str
    kind: str = DONE
    value: Any = None
    detail: str = ""
    attempts: int = 1


@dataclass(frozen=True, kw_only=True)
class Workers:
    """What runs the tasks of a study.

    Args:
        executor: any; unless it is a `ProcessPerTaskExecutor`, its workers start processes for the tasks.
        window: returns the most tasks to submit at a time; others wait here.
        checks: called several times a second while tasks run; an exception from one ends the run.
        show: called as often with the names of the running tasks.
    """

    executor: Executor
    window: Callable[[], int]
    checks: tuple[Callable[[], object], ...] = ()
    show: Callable[[Collection[str]], object] | None = None

    def watched(self, check: Callable[[], object], show: Callable[[Collection[str]], object]) -> "Workers":
        """The same workers with one more check, and what shows their tasks."""
        return replace(self, checks=(check, *self.checks), show=show)

    def run(
        self, waiting: deque[Key], make: Callable[[Key], TimedCall], *, attempts: int = 1
    ) -> Iterator[Ended[Key]]:
        """Run tasks, including those that the caller appends meanwhile; yield each as it ends.

        Args:
            waiting: keys of tasks; the caller may change it between two results.
            make: returns the task of a key when it is started; a `TaskError` that it raises is the outcome.
            attempts: most times that a task is run if its process is lost.

        Raises:
            InputError: if the executor breaks down, or the script lacks its main guard.
        """
        running: dict[Future[Any], tuple[Key, str]] = {}
        tried = Counter[Key]()
        while waiting or running:
            while waiting and len(running) < max(1, self.window()):
                key = waiting.popleft()
                tried[key] += 1
                try:
                    task = make(key)
                except TaskError as error:
                    yield Ended(key=key, name="", kind=error.kind, detail=_text(error))
                    continue
                running[self._submitted(task)] = key, task.name
            self._check()
            ended = wait(running, timeout=LOOK, return_when=FIRST_COMPLETED).done
            if self.show is not None:
                self.show([name for future, (_, name) in running.items() if future.running()])
            for future in [future for future in running if future in ended]:  # in the order of submission
                key, name = running.pop(future)
                failure = self._failure(future)
                lost = isinstance(failure, LostTaskError) and failure.kind == LOST
                if lost and tried[key] < attempts:
                    waiting.append(key)
                elif failure is not None:
                    kind = getattr(failure, "kind", LOST)
                    yield Ended(key=key, name=name, kind=kind, detail=_text(failure), attempts=tried[key])
                else:
                    yield Ended(key=key, name=name, value=future.result(), attempts=tried[key])

    def _submitted(self, task: TimedCall) -> Future[Any]:
        run = limited if isinstance(self.executor, ProcessPerTaskExecutor) else limited_anywhere
        try:
            return self.executor.submit(run, task.limit, task.function, *task.args)
        except (BrokenExecutor, RuntimeError) as error:
            raise self._broken(error) from None

    def _failure(self, future: Future[Any]) -> Exception | None:
        """The error of a task that has ended, from itself or an executor that lost its worker too often."""
        try:
            future.result()
        except UnguardedScriptError:
            raise
        except (BrokenExecutor, CancelledError) as error:
            raise self._broken(error) from None
        except Exception as error:
            return error
        return None

    def _check(self) -> None:
        for check in self.checks:
            check()

    def _broken(self, error: BaseException) -> InputError:
        self._check()
        return InputError(f"the executor has broken down: {_text(error)}", KEPT)


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


@contextmanager
def open_workers(
    *, executor: Executor | None = None, scheduler: str | None = None, jobs: int | None = None
) -> Iterator[Workers]:
    """The workers of an executor or a Dask scheduler; else processes that end with the context.

    Args:
        executor: any of `concurrent.futures`.
        scheduler: address of a running Dask scheduler, such as ``tcp://127.0.0.1:8786``.
        jobs: number of processes on this machine; default: one per processor.

    Raises:
        InputError: if more than one is given, or no scheduler answers.
    """
    for name, given in (("executor", executor), ("scheduler", scheduler)):
        if jobs is not None and given is not None:
            raise InputError("`jobs` has no effect here", f"allowed: without `{name}`")
    if scheduler is not None:
        with _dask_workers(scheduler) as found:
            yield found
    elif executor is not None:
        count = getattr(executor, "_max_workers", None)
        most = TASKS_PER_PROCESS * count if count else MOST_SUBMITTED
        yield Workers(executor=executor, window=lambda: most)
    else:
        count = jobs or processors()
        with local_executor(count) as processes:
            yield Workers(executor=processes, window=lambda: TASKS_PER_PROCESS * count)


@contextmanager
def _dask_workers(address: str) -> Iterator[Workers]:
    distributed = optional_package("distributed", what="`scheduler`", extra="batch")
    # A client with an invalid address raises, and again when the process ends.
    match = re.fullmatch(ADDRESS, address)
    if not match or int(match[1]) > LAST_PORT:
        raise InputError(f"no scheduler answers at '{address}': the form is wrong", ADDRESS_FORM)
    # Lost connections are one line here, not tracebacks of Dask and its event loop.
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=DASK_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"no scheduler answers at {address}: {reason}", ADDRESS_FORM) from None

    def check() -> None:
        if client.status != CONNECTED:
            raise InputError(f"the scheduler at {address} is gone", KEPT)

    @functools.lru_cache(maxsize=1)
    def threads(period: int) -> int:
        return sum(client.nthreads().values())

    def window() -> int:
        return max(TASKS_PER_THREAD * threads(int(time.monotonic() / COUNT_PERIOD)), LEAST_SUBMITTED)

    try:
        # Not pure: two cases with the same parameters are two tasks.
        yield Workers(executor=client.get_executor(pure=False), window=window, checks=(check,))
    finally:
        # Without a scheduler, nobody answers: `check` gives the reason, not this wait.
        with suppress(OSError):
            client.close(timeout=DASK_PATIENCE if client.status == CONNECTED else 0)


def _text(error: BaseException) -> str:
    return " ".join(f"{error}".split()) or type(error).__name__
