"""A watch that shows iterates in Meshcat from a separate thread: the solver never waits for it."""

from __future__ import annotations

import sys
import threading
import time
import warnings
from queue import SimpleQueue

import zmq

from trajopt.motion.solution import Solution
from trajopt.solving.monitoring import Iterate
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.motion import replay_motion
from trajopt.view.replay.scene import build_scene
from trajopt.view.replay.show import LiveWindow
from trajopt.view.watching.drawing import TOP, IterateScene, Picture

# Most iterates drawn per second.
RATE = 5.0
# Largest share of a processor for drawing, apart from the scene of a new problem.
SHARE = 0.1
# Longest wait of the solver's thread for Python's lock while the viewer's thread runs, s; Python's default of
# 5 ms would be a tenth of an iteration of a jump.
SWITCH = 5e-4
# Longest wait of a solve for the picture of its guess, s.
FIRST = 10.0
# Polling interval of `Viewer.flush`, s.
PAUSE = 0.01
# Time limit for an answer of the server, ms.
ANSWER = 5000


class Viewer:
    """A watch for `trajopt.solve`: ``solve(problem, watch=Viewer())`` shows its iterates at ``url``.

    The robot plays the motion of the current iterate, translucent poses show its changes of phase, and lines
    the paths of feet and centre of mass. If the viewer fails, it warns and the solve continues. Close it, or
    use it as a context manager, to stop its server. Raises `TrajoptError` if the server does not start.
    """

    def __init__(self, *, open_browser: bool = False) -> None:
        self._window = LiveWindow()
        for option in (zmq.RCVTIMEO, zmq.SNDTIMEO):
            self._window.zmq_socket.setsockopt(option, ANSWER)
        self._switch = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH, self._switch))
        self._scene = IterateScene()
        # Counters of accepted and finished iterates instead of a lock, which an interrupt could leave held.
        self._given: SimpleQueue[Iterate | Solution | None] = SimpleQueue()
        self._put_in = self._done = 0
        self._closed = self._failed = False
        self._free = 0.0
        self.drawn = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        if open_browser:
            self._window.open()

    @property
    def url(self) -> str:
        """Address of the viewer's page."""
        return self._window.web_url

    def __call__(self, iterate: Iterate) -> None:
        """Accept an iterate if the viewer is ready for one; guesses and ends are always accepted.

        Returns at once while the solver runs; a guess and its problem's scene are drawn before it starts.
        """
        if not self.alive:
            return
        if iterate.stage == "iteration" and (not self._idle or time.perf_counter() < self._free):
            return
        if iterate.unknowns is not None:  # read now: they are valid only during the solver's call
            self._put(iterate)
        if iterate.stage == "guess":
            self.flush(FIRST)

    def show(self, solution: Solution) -> None:
        """Show the replay of a solution in place of the iterates."""
        if self.alive:
            self._put(solution)

    def flush(self, timeout: float = 60.0) -> bool:
        """Wait until all accepted iterates are drawn; returns whether that took less than ``timeout`` s."""
        end = time.monotonic() + timeout
        while not (self._idle or self._failed):
            if time.monotonic() > end:
                return False
            time.sleep(PAUSE)
        return True

    @property
    def alive(self) -> bool:
        """Whether the viewer has neither failed nor been closed."""
        return not (self._failed or self._closed)

    def wait(self, timeout: float) -> bool:
        """Block until the server ends, at most ``timeout`` s; returns whether it has ended."""
        return self._window.ended(timeout)

    def close(self) -> None:
        """Stop the thread and the server, unless they have been stopped."""
        if self._closed:
            return
        sys.setswitchinterval(self._switch)
        self._closed = True
        self._given.put(None)
        self._thread.join(2 * ANSWER / 1000)
        self._window.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def _idle(self) -> bool:
        return self._done == self._put_in

    def _put(self, what: Iterate | Solution) -> None:
        self._put_in += 1
        self._given.put(what)

    def _run(self) -> None:
        while not (self._closed or self._failed):
            what = self._given.get()
            if self._given.empty() and not self._closed:  # only the latest one is drawn
                self._attempt(what)
            self._done += 1

    def _attempt(self, what: Iterate | Solution | None) -> None:
        try:
            self._draw(what)
        except Exception as error:
            try:  # before the failure is flagged: whoever waits for that may close the viewer
                if not self._closed:
                    text = " ".join(f"{type(error).__name__}: {error}".split())
                    warnings.warn(f"the viewer has stopped, solving goes on: {text}", stacklevel=2)
            finally:
                self._failed = True

    def _draw(self, what: Iterate | Solution | None) -> None:
        begin, used = time.perf_counter(), time.thread_time()
        if isinstance(what, Solution):
            scene = build_scene([what], [replay_motion(what)])
            clear = ViewerCommand({"type": "delete", "path": TOP})
            self._window.show([clear, *scene.commands], scene.facts)
        elif what is not None:
            picture = self._scene.picture(what)
            if picture is not None:
                self._tell(picture)
            # the scene of a guess is drawn once
            spent = 0.0 if what.stage == "guess" else time.thread_time() - used
            self._free = max(begin + 1 / RATE, time.perf_counter() + spent * (1 / SHARE - 1))
        self.drawn += 1

    def _tell(self, picture: Picture) -> None:
        if picture.new:
            self._window.show(picture.commands, picture.facts)
            return
        for command in picture.commands:
            self._window.send(command)
        self._window.tell("facts", picture.facts)
        self._window.tell("drawn", True)
