"""Where tasks run: processes on this machine, a given executor, or a running Dask cluster."""

import logging
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from trajopt.errors import InputError
from trajopt.study.runner import local_executor
from trajopt.study.workers.executor import processors
from trajopt.versions import optional_package

# Seconds within which a scheduler has to answer.
PATIENCE = 10.0
# Tasks submitted at a time: per process on this machine, and to an executor that does not report its number
# of workers.
AHEAD_HERE, MOST_AHEAD = 2, 1000
# Tasks submitted at a time per thread of Dask's workers, so that none waits for the next one, and their least
# number while workers join.
AHEAD, LEAST_AHEAD = 3, 8
RUNS = "running"
# Seconds after which workers are counted again.
AGAIN = 5.0
ADDRESS, LAST_PORT = r"(?:(?:tcp|tls)://)?(?:\[[^\]\s]+\]|[^\s:/\[\]]+):([0-9]{1,5})", 65535
ALLOWED = "allowed: tcp://HOST:PORT of a Dask scheduler"


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """An executor; ``window``: tasks to submit at a time; ``check`` raises if the scheduler is gone."""

    executor: Executor
    window: Callable[[], int]
    check: Callable[[], None]


@contextmanager
def local_or(executor: Executor | None, jobs: int | None) -> Iterator[Cluster]:
    """The given executor, or processes on this machine that end with the context."""
    if executor is not None:
        workers = getattr(executor, "_max_workers", None)
        most = AHEAD_HERE * workers if workers else MOST_AHEAD
        yield Cluster(executor=executor, window=lambda: most, check=lambda: None)
        return
    count = jobs or processors()
    with local_executor(count) as processes:
        yield Cluster(executor=processes, window=lambda: AHEAD_HERE * count, check=lambda: None)


@contextmanager
def chosen_cluster(scheduler: str | None, jobs: int | None) -> Iterator[Cluster]:
    """What ``--scheduler`` and ``--jobs`` name. Raises `InputError` for both, or if no scheduler answers."""
    if jobs is not None and scheduler is not None:
        raise InputError("--jobs has no effect here", "allowed: without --scheduler")
    with local_or(None, jobs) if scheduler is None else dask_cluster(scheduler) as cluster:
        yield cluster


def last_for(seconds: float) -> Callable[[Callable[[], int]], Callable[[], int]]:
    """Return a decorator that caches a function's value for this many seconds."""

    def decorate(function: Callable[[], int]) -> Callable[[], int]:
        known: list[float] = []

        def call() -> int:
            now = time.monotonic()
            if not known or now - known[0] > seconds:
                known[:] = [now, function()]
            return int(known[1])

        return call

    return decorate


@contextmanager
def dask_cluster(address: str) -> Iterator[Cluster]:
    """Connect to a scheduler, such as ``tcp://127.0.0.1:8786``. Raises `InputError` if none answers."""
    distributed = optional_package("distributed", what="--scheduler", extra="batch")
    # A client with an invalid address raises, and again when the process ends.
    match = re.fullmatch(ADDRESS, address)
    if not match or int(match[1]) > LAST_PORT:
        raise InputError(f"no scheduler answers at '{address}': the form is wrong", ALLOWED)
    _silence()
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"no scheduler answers at {address}: {reason}", ALLOWED) from None

    def check() -> None:
        if client.status != RUNS:
            raise InputError(
                f"the scheduler at {address} is gone", "what was reported is kept; go on with --resume"
            )

    @last_for(AGAIN)
    def window() -> int:
        return max(AHEAD * sum(client.nthreads().values()), LEAST_AHEAD)

    try:
        # Not pure: two cases with the same parameters are two tasks.
        yield Cluster(executor=client.get_executor(pure=False), window=window, check=check)
    finally:
        # Without a scheduler, nobody answers: `check` gives the reason, not this wait.
        with suppress(OSError):
            client.close(timeout=PATIENCE if client.status == RUNS else 0)


def _silence() -> None:
    """Keep Dask and its event loop from logging tracebacks of lost connections, which are one line here."""
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
