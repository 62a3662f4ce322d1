"""What a sweep shows while it runs, on stderr: a live line on a terminal, else one line a run."""

from __future__ import annotations

import sys
from types import TracebackType

from rich.console import Console
from rich.status import Status


class Lines:
    """One line for each thing that has ended; on a terminal one that changes below them says what runs."""

    def __init__(self, title: str) -> None:
        self._console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
        live = sys.stderr.isatty() and not self._console.is_dumb_terminal
        self._status = Status(title, console=self._console) if live else None
        self._left = 0

    def __enter__(self) -> Lines:
        if self._status:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status:
            self._status.stop()

    def note(self, text: str) -> None:
        """Something to say."""
        self._console.print(text)

    def left(self, count: int) -> None:
        """So many tasks are left."""
        self._left = count

    def started(self, text: str) -> None:
        """A task begins."""
        if self._status:
            self._status.update(f"{self._left} left: {text}"[: max(1, self._console.width - 3)])

    def finished(self, text: str) -> None:
        """A task has ended."""
        self._console.print(text)
