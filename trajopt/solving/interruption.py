"""Ctrl-C: every press takes effect, whatever the program is doing."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType, TracebackType

# What a shell reports for a program ended by Ctrl-C: 128 + SIGINT.
CANCELLED = 130
# Seconds after which a press without effect is raised again.
AGAIN = 0.2
# Seconds between two checks for Ctrl-C during a wait.
LOOK = 0.1
# Most seconds that the last line of a program waits for a blocked terminal.
LAST_WORDS = 1.0
# Undoes what a live line does to the terminal's cursor, on a line of its own.
SHOW_CURSOR = "\x1b[?25h\n"
# Wakes the main thread; ignored where it has no handler.
WAKE = signal.SIGURG


class Interruption:
    """Ctrl-C from the first line of a command to its last.

    A press raises KeyboardInterrupt, except within `recording`, where waits are short and check ``pressed``.
    Python's own handler may lose one: the exception disappears in a destructor, or where bindings try
    conversions; and a signal that comes just before a system call that blocks waits as long as the call.
    So the C handler notes each press in a pipe (`signal.set_wakeup_fd`), and a thread that reads the pipe
    wakes the main thread, which raises again, every `AGAIN` s until `answer` is called. Nothing is raised
    where a KeyboardInterrupt is being handled: clean-up is not interrupted.

    A second press ends the program at once if the first has raised nothing yet, a third one in any case.
    Where Ctrl-C is ignored (nohup), or outside the main thread, nothing is changed.

    note: text after "cancelled" in the last line of a program that is ended at once.
    stops: whether a press has asked a solver to stop, which may have ended just before.
    """

    def __init__(self) -> None:
        self.note = ""
        self.stops = False
        self._raises = self._handled = self._raised = self._active = False
        self._presses = 0  # noted in the pipe, and not answered
        self._lock = threading.Lock()

    def __enter__(self) -> Interruption:
        heeded = signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None)
        self._active = heeded and threading.current_thread() is threading.main_thread()
        if self._active:
            self._previous = signal.signal(signal.SIGINT, self._handle)  # raises nothing yet
            self._previous_wake = signal.signal(WAKE, self._handle)
            self._read, self._write = os.pipe()
            for end in (self._read, self._write):
                os.set_blocking(end, False)
            self._previous_fd = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            self._main = threading.get_ident()
            self._watcher = threading.Thread(target=self._watch, name="Ctrl-C", daemon=True)
            self._watcher.start()
        self._raises = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._raises = False
        if self._active:
            signal.set_wakeup_fd(self._previous_fd)
            os.close(self._write)  # ends the watcher
            self._watcher.join()
            os.close(self._read)
            signal.signal(WAKE, self._previous_wake)
            signal.signal(signal.SIGINT, self._previous)

    @property
    def pressed(self) -> bool:
        """Whether there was a press that is not answered."""
        return self._handled or self._presses > 0

    def check(self) -> None:
        """Raise KeyboardInterrupt if there was a press that is not answered."""
        if self.pressed:
            self._raised = True
            raise KeyboardInterrupt

    def answer(self) -> None:
        """Count all presses so far as answered: their request is done, the next press is a first one."""
        before, self._raises = self._raises, False
        with self._lock:
            self._take()
            self._presses = 0
            self._handled = self._raised = False
        self._raises = before

    def record(self) -> None:
        """Raise nothing from now on, as within `recording`, which ends it."""
        self._raises = False

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Raise nothing but by `check`, and at the end what was not answered: no step is cut in two."""
        before, self._raises = self._raises, False
        try:
            yield
        finally:
            self._raises = before
            if before:
                self.check()

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise again, within `recording`."""
        before, self._raises = self._raises, True
        try:
            self.check()
            yield
        finally:
            self._raises = before

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._handled = self._handled or number == signal.SIGINT
        if self._raises and not _being_handled():
            self.check()

    def _watch(self) -> None:
        while True:
            select.select([self._read], [], [], AGAIN if self.pressed else None)
            with self._lock:
                if not self._take():
                    return
            if self._presses > (2 if self._raised else 1):
                end_at_once(f"trajopt: cancelled{self.note}\n", CANCELLED)
            if self.pressed and self._raises:
                signal.pthread_kill(self._main, WAKE)

    def _take(self) -> bool:
        """Count the presses in the pipe; False where it is closed."""
        if not self._active:
            return False
        try:
            data = os.read(self._read, select.PIPE_BUF)
        except BlockingIOError:
            return True
        self._presses += data.count(signal.SIGINT)
        return bool(data)


_CURRENT: ContextVar[Interruption | None] = ContextVar("interruption", default=None)


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """The interruption of the command that runs, or one from here on where there is none."""
    current = _CURRENT.get()
    if current is not None:
        yield current
        return
    with Interruption() as current:
        token = _CURRENT.set(current)
        try:
            yield current
        finally:
            _CURRENT.reset(token)


def _being_handled() -> bool:
    """Whether a signal interrupts the except or finally block that handles a KeyboardInterrupt."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def end_at_once(text: str, status: int) -> None:
    """End the program from any thread, whatever the others do: one may hold the lock of ``sys.stderr``."""
    shown = SHOW_CURSOR if os.isatty(2) else ""
    with contextlib.suppress(OSError):
        if select.select([], [2], [], LAST_WORDS)[1]:
            os.write(2, f"{shown}{text}".encode())
    os._exit(status)


# Seconds after its time limit that a solver may take to finish a step.
GRACE = 30.0
# Seconds for what is not the solver's in a solve to a grade: building, compiling and checking its meshes, an
# order of magnitude above what the largest robots take on a busy machine.
BESIDE = 600.0
