"""What a half of the comparison of collocation answers: a plan and its times. Only NumPy is needed."""

import itertools
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np

# Fractions of an interval where a plan's states are told, beside its start.
TOLD = np.array([0.25, 0.5, 0.75, 1.0])


class Stopwatch:
    """Seconds of the clock and of the processor that a block takes."""

    def __enter__(self) -> "Stopwatch":
        self._begun = time.perf_counter(), time.process_time()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.seconds = time.perf_counter() - self._begun[0]
        self.processor = time.process_time() - self._begun[1]


def times_told(breaks: np.ndarray) -> np.ndarray:
    """Times (4 n + 1,) at which the states of n intervals are told, s."""
    return np.append(breaks[0], (breaks[:-1, None] + np.diff(breaks)[:, None] * TOLD).ravel())


def lines(knots: np.ndarray) -> list[np.ndarray]:
    """Inputs that are straight between knots (n + 1, nu), as a plan has them."""
    return [np.array([a, b - a]) for a, b in itertools.pairwise(knots)]


def numbers(values: Sequence[float | None], missing: float) -> np.ndarray:
    """Limits as described, with a number for those that are None."""
    return np.array([missing if value is None else value for value in values])


def plan(
    *,
    build: float,
    watch: Stopwatch,
    solved: bool,
    breaks: np.ndarray,
    inputs: Sequence[np.ndarray],
    times: np.ndarray,
    states: np.ndarray,
) -> dict[str, Any]:
    """A plan as JSON has it.

    Args:
        build: time before the solver starts, s.
        watch: around the solver.
        solved: whether it converged.
        breaks: (n + 1,) ends of intervals, s.
        inputs: of each interval, coefficients (k, nu) of torques by powers of its fraction.
        times: (m,) s, at which the plan's states are told, nodes among them.
        states: (m, 2 nv) positions and rates there.
    """
    return {
        "build": build,
        "seconds": watch.seconds,
        "processor": watch.processor,
        "solved": bool(solved),
        "breaks": breaks.tolist(),
        "inputs": [part.tolist() for part in inputs],
        "times": times.tolist(),
        "states": states.tolist(),
    }
