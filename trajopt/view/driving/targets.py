"""Where a target that an arm follows is over time."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np


class TargetPath:
    """A target that goes in straight lines, at one speed, to where it was last sent.

    Args:
        start: where it is until then (3,), m.
        speed: m/s.

    goals: times, s, and places (3,), m, to which it was sent.
    """

    def __init__(self, start: np.ndarray, speed: float) -> None:
        self._speed = speed
        self.goals = [(0.0, start)]
        self._from = [start]

    def send(self, time: float, goal: np.ndarray) -> None:
        """Send it to another place (3,), m, at ``time`` s, which is not before the last one."""
        if not np.array_equal(goal, self.goals[-1][1]):
            start, _ = self.at(time)
            self.goals.append((time, goal))
            self._from.append(start)

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Its place (3,) m and velocity (3,) m/s at ``time`` s."""
        last = max(bisect_right(self.goals, time, key=lambda sent: sent[0]) - 1, 0)
        (begun, goal), start = self.goals[last], self._from[last]
        way = goal - start
        far, gone = float(np.linalg.norm(way)), self._speed * (time - begun)
        if gone >= far:
            return goal, np.zeros(3)
        return start + gone / far * way, self._speed / far * way
