"""What is shown on stderr while tasks run: a line for each that has ended, on a terminal what runs below."""

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
    """A table without lines of rows by title; columns but those of ``left`` are of numbers.

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
    """Lines of text; on a terminal that can move its cursor a bar over all tasks and one for each that runs.

    title: of the bar over all. total: tasks in all, of which ``done`` are known. Any thread may call it.
    """

    def __init__(self, title: str, total: int = 0, done: int = 0) -> None:
        console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not sys.stderr.isatty() or console.is_dumb_terminal,
        )
        self._total = total
        self._all = self._progress.add_task(title, total=total, completed=done, state="")
        self._running: dict[str, TaskID] = {}

    def __enter__(self) -> TaskDisplay:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self._progress.stop()

    def note(self, text: str) -> None:
        """Say something."""
        self._progress.console.print(text)

    def show(self, name: str, state: str = "", *, steps: int = 1, advance: int = 0) -> None:
        """A task runs, of so many steps: what it does now, and how many more of them are done."""
        if name not in self._running:
            self._running[name] = self._progress.add_task(name, total=steps, state=state)
        self._progress.update(self._running[name], state=state, advance=advance)

    def more(self, count: int = 1) -> None:
        """There are so many more tasks, or fewer."""
        self._total += count
        self._progress.update(self._all, total=self._total)

    def finished(self, name: str, text: str = "") -> None:
        """A task has ended: its line, if any, above what runs."""
        if name in self._running:
            self._progress.remove_task(self._running.pop(name))
        self._progress.advance(self._all)
        if text:
            self.note(text)
