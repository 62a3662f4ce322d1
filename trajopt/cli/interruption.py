"""Ctrl-C on the command line: ends a command, or stops a solver at its iterate; a second one ends at once."""

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# What a shell reports for a program ended by Ctrl-C: 128 + SIGINT.
CANCELLED = 130
# Most seconds that the last line of a program waits for a blocked terminal.
LAST_WORDS = 1.0
# Undoes what a live line does to the terminal's cursor, on a line of its own.
SHOW_CURSOR = "\x1b[?25h\n"


class Interruption:
    """Ctrl-C while a command runs.

    A press raises KeyboardInterrupt in the main thread, except while ``deferred``: then it is only
    ``pressed``, for a loop or a solver's callback that looks. Nothing is raised where a KeyboardInterrupt is
    being handled: clean-up is not interrupted. A library may lose the exception, so ``pressed`` stays until
    `answer`.

    A second press ends the program if the first has raised nothing yet, a third one in any case. Handlers of
    Python wait until native code returns, such as a factorisation that lasts; so a thread counts the presses.
    Where Ctrl-C is ignored (nohup), or outside the main thread, nothing is changed.

    stops: whether a press has asked a solver to stop, which may have ended just before.
    """

    def __init__(self) -> None:
        self.pressed = self.deferred = self.stops = False
        self._handles = self._raised = False
        self._presses, self._lock = 0, threading.Lock()

    @contextmanager
    def handling(self) -> Iterator[None]:
        """Handle Ctrl-C from here on, unless that is done already, or Ctrl-C is ignored."""
        heeded = signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None)
        if self._handles or not heeded or threading.current_thread() is not threading.main_thread():
            yield
            return
        self.answer()
        self.deferred = self.stops = False
        self._read, write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(write, False)
        before = signal.signal(signal.SIGINT, self._handle)
        previous = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        self._told, sys.unraisablehook = sys.unraisablehook, self._lost
        watcher = threading.Thread(target=self._watch, name="Ctrl-C", daemon=True)
        watcher.start()
        self._handles = True
        try:
            yield
        finally:
            self._handles = False
            sys.unraisablehook = self._told
            signal.set_wakeup_fd(previous)
            os.close(write)  # ends the watcher
            watcher.join()
            os.close(self._read)
            signal.signal(signal.SIGINT, before)

    def check(self) -> None:
        """Raise KeyboardInterrupt if there was a press that is not answered."""
        if self.pressed:
            self._raised = True
            raise KeyboardInterrupt

    def answer(self) -> None:
        """Count all presses so far as answered: their request is done, the next press is a first one."""
        with self._lock:
            if self._handles:
                self._take()
            self._presses = 0
            self.pressed = self._raised = False

    @contextmanager
    def deferring(self) -> Iterator[None]:
        """Raise nothing but by `check`, and at the end what was not answered: no step is cut in two."""
        before, self.deferred = self.deferred, True
        try:
            yield
        finally:
            self.deferred = before
            if not before:
                self.check()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.pressed = True
        if not (self.deferred or _is_being_handled()):
            self.check()

    def _lost(self, what: "sys.UnraisableHookArgs") -> None:
        """Say nothing of a press that Python loses in a destructor: it stays ``pressed``."""
        if not issubclass(what.exc_type, KeyboardInterrupt):
            self._told(what)

    def _watch(self) -> None:
        while True:
            select.select([self._read], [], [])
            with self._lock:
                if not self._take():
                    return
                too_many = self._presses > (2 if self._raised else 1)
            if too_many:
                end_at_once("trajopt: cancelled\n", CANCELLED)

    def _take(self) -> bool:
        """Count the presses in the pipe; False where it is closed."""
        try:
            data = os.read(self._read, select.PIPE_BUF)
        except BlockingIOError:
            return True
        self._presses += data.count(signal.SIGINT)
        return bool(data)


# That of the command that runs.
INTERRUPTION = Interruption()


def _is_being_handled() -> bool:
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
