"""Clocks of drives: as fast as the controller plans, or with real time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from trajopt.simulation.driven_scene import DrivenScene

# Simulated time between two tests for a fall in lockstep, and between two looks at real time, s.
TEST, STRETCH = 0.1, 0.02
# Largest delay that is caught up, s.
CATCH = 0.1
# Window over which the pace is measured, s.
WINDOW = 1.0


def lockstep(driven: DrivenScene) -> int:
    """The `Clock` by which simulated time waits for the controller, until the record is full or a fall."""
    left = len(driven.timeline.t) - driven.row
    return 0 if driven.fall is not None else min(left, _ticks(driven, TEST))


def _ticks(driven: DrivenScene, seconds: float) -> int:
    return max(1, round(seconds / driven.timeline.period))


class WallClock:
    """A clock by which simulated time waits for real time; delays beyond `CATCH` are not caught up.

    Args:
        now: real time since an arbitrary origin, s.
        sleep: waits for a time in s.

    Attributes:
        behind: time by which simulated time has fallen behind, s.
    """

    def __init__(
        self, now: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self.now, self.sleep, self.behind = now, sleep, 0.0
        self.begin()

    def begin(self) -> None:
        """Start both times anew."""
        self._origin = self.now()
        self._marks = deque([(self._origin, 0.0)])

    def ticks(self, driven: DrivenScene) -> int:
        """Sleep until real time reaches simulated time, or beside a fallen robot; the ticks of a stretch."""
        count, now = _ticks(driven, STRETCH), self.now()
        if driven.fall is not None:
            self._origin = now - driven.passed
            self.sleep(STRETCH)
            return count
        ahead = self._origin + driven.passed - now
        if ahead > 0:
            self.sleep(ahead)
        elif -ahead > CATCH:
            self._origin, self.behind = self._origin - ahead - CATCH, self.behind - ahead - CATCH
        self._marks.append((self.now(), driven.passed))
        while len(self._marks) > 2 and self._marks[-1][0] - self._marks[0][0] > WINDOW:
            self._marks.popleft()
        return count

    @property
    def pace(self) -> float:
        """Ratio of simulated to real time over the last `WINDOW` s."""
        (begin, before), (end, after) = self._marks[0], self._marks[-1]
        return (after - before) / (end - begin) if end > begin else 1.0
