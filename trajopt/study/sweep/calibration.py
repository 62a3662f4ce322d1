"""A fixed load that is timed next to every run: how fast the machine is at that moment.

It mixes the work of a solve: dense linear algebra in the cache, passes over memory beyond it, and Python. Its
time rises when another process shares the core, the caches, the memory or the clock of the processor.
"""

import statistics
import time

import numpy as np

# Order of a matrix within the second-level cache, and doubles well beyond it (8 MB).
ORDER = 200
DOUBLES = 1_000_000
COUNTS = 20_000
# Loads of about 1 ms whose median is one calibration: short against a run, long enough to meet disturbances.
LOADS = 25


class Load:
    """The load; its arrays are allocated once."""

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        square = generator.standard_normal((ORDER, ORDER))
        self._matrix = square @ square.T + ORDER * np.eye(ORDER)
        self._long = generator.standard_normal(DOUBLES)

    def seconds(self, loads: int = LOADS) -> float:
        """Median time of ``loads`` loads, s."""
        return statistics.median(self._once() for _ in range(loads))

    def _once(self) -> float:
        begin = time.perf_counter()
        np.linalg.cholesky(self._matrix)
        self._long.sum()
        total = 0
        for count in range(COUNTS):
            total += count
        return time.perf_counter() - begin
