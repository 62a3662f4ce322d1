"""Display on stderr while tasks run: a line per finished task; on a terminal, the running ones below."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table


def figure_table(
    rows: Sequence[Mapping[str, str]],
    left: Collection[str],
    *,
    fold: Collection[str] = (),
    whole: Collection[str] = (),
) -> Table:
    """A table without rules, from rows by title; columns other than ``left`` hold numbers.

    fold: columns whose text may take several lines. whole: columns that are never cut short.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in rows[0] if rows else ():
        table.add_column(
            title,
            justify="left" if title in left else "right",
            no_wrap=title not in fold,
            overflow="fold" if title in fold else "ellipsis",
            min_width=max(len(row[title]) for row in rows) if title in whole else None,
        )
    for row in rows:
        table.add_row(*row.values())
    return table


class TaskDisplay:
    """Lines of text; on a terminal that can move its cursor, a bar for all tasks and one per running task.

    title: of the bar for all. total: number of tasks, of which ``done`` have results. Any thread may call it.
    """

    def __init__(self, title: str, total: int = 0, done: int = 0) -> None:
        console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not sys.stderr.isatty() or console.is_dumb_terminal,
        )
        self._total = total
        self._all = self._progress.add_task(title, total=total, completed=done)
        self._running: dict[str, TaskID] = {}

    def __enter__(self) -> TaskDisplay:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self._progress.stop()

    def note(self, text: str) -> None:
        """Print a line."""
        self._progress.console.print(text)

    def show(self, names: Collection[str]) -> None:
        """Show these tasks as running."""
        for name in [name for name in self._running if name not in names]:
            self._progress.remove_task(self._running.pop(name))
        for name in names:
            if name not in self._running:
                self._running[name] = self._progress.add_task(name, total=None)

    def more(self, count: int = 1) -> None:
        """Change the number of tasks."""
        self._total += count
        self._progress.update(self._all, total=self._total)

    def finished(self, text: str = "") -> None:
        """Count an ended task, and print its line, if any, above the running ones."""
        self._progress.advance(self._all)
        if text:
            self.note(text)
