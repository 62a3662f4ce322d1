"""Tasks that run on an executor: submitted under a key, taken as they end."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, Generic, TypeVar

# Seconds between two calls of ``check`` during a wait.
LOOK = 0.1

Key = TypeVar("Key")


class RunningTasks(Generic[Key]):
    """What runs on an executor.

    Args:
        executor: any of `concurrent.futures`.
        check: called several times a second while waiting; an exception from it ends the wait.
    """

    def __init__(self, executor: Executor, check: Callable[[], object] = bool) -> None:
        self._executor, self._check = executor, check
        self._running: dict[Future[Any], Key] = {}

    def __len__(self) -> int:
        return len(self._running)

    def submit(self, key: Key, function: Callable[..., Any], /, *args: Any) -> None:
        """Run ``function(*args)`` under a key."""
        self._running[self._executor.submit(function, *args)] = key

    def ended(self) -> list[tuple[Key, Future[Any]]]:
        """Wait until some have ended; these, in the order in which they were submitted."""
        while True:
            self._check()
            done = wait(self._running, timeout=LOOK, return_when=FIRST_COMPLETED).done
            if done or not self._running:
                return [(self._running.pop(future), future) for future in [*self._running] if future in done]
