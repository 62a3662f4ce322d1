"""Clocks of drives: in lockstep until the record is full, in real time without catching up long delays."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajopt.simulation.clock import CATCH, STRETCH, TEST, WallClock, lockstep
from trajopt.simulation.figures import Fall

PERIOD = 1e-3


def driven(passed: float = 0.0, fall: Fall | None = None) -> Any:
    """What a clock reads of a drive with a record of a second."""
    timeline = SimpleNamespace(period=PERIOD, t=PERIOD * np.arange(1000))
    return SimpleNamespace(passed=passed, row=round(passed / PERIOD), fall=fall, timeline=timeline)


def test_in_lockstep_a_drive_ends_with_its_record_or_a_fall():
    assert lockstep(driven()) == round(TEST / PERIOD)
    assert lockstep(driven(passed=0.95)) == 50
    assert lockstep(driven(passed=1.0)) == 0
    assert lockstep(driven(passed=0.5, fall=Fall(time=0.5, why="it slipped"))) == 0


def test_simulated_time_waits_for_real_time():
    slept: list[float] = []
    clock = WallClock(lambda: 7.0, slept.append)
    assert clock.ticks(driven(passed=STRETCH)) == round(STRETCH / PERIOD)
    assert slept == [pytest.approx(STRETCH)]
    assert clock.behind == 0.0


def test_a_long_delay_is_given_up_and_a_short_one_caught_up():
    times = iter([0.0, 0.5 * CATCH, 0.5 * CATCH, 1.0, 1.0])
    clock = WallClock(lambda: next(times), pytest.fail)
    clock.ticks(driven())
    assert clock.behind == 0.0
    clock.ticks(driven(passed=0.5))
    assert clock.behind == pytest.approx(0.5 - CATCH)
    assert clock.pace == pytest.approx(0.5)
