"""A package of families for the tests of sweeps: small ones, and one that is lost on some grids."""

import os
import signal
import time
from dataclasses import replace

import numpy as np

from tests.support.problems import REACH_TIME, reach
from trajopt.errors import InputError
from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem

# Times of nodes agree to rounding, s.
SAME_TIME = 1e-9


def _raises() -> None:
    raise RuntimeError("first line\nsecond line")


def _refuses() -> None:
    raise InputError("a seventh of the way is not allowed", "allowed: the rest")


# Numbers of intervals, primes to each other and to 4 and 10, and how a solve on that grid is lost.
LOST = {
    3: lambda: os.kill(os.getpid(), signal.SIGSEGV),
    7: _refuses,
    11: _raises,
    13: lambda: time.sleep(3600),
}


def losing() -> Problem:
    """A reach whose guess is never given at the first node of some grids."""
    problem = reach(gravity=True)

    def guess(t: float) -> np.ndarray:
        for count, lose in LOST.items():
            if abs(t - REACH_TIME / count) < SAME_TIME:
                lose()
        return problem.guess(t)

    return replace(problem, guess=guess)


def weighed(*, gravity: float) -> Problem:
    return replace(reach(gravity=gravity > 0), name="s-reach")


def families() -> dict[str, Family]:
    """The families by name; one of them has a parameter."""
    gravity = Parameter(
        name="gravity", default=1.0, unit="", lower=0.0, upper=1.0, meaning="1 with, 0 without"
    )
    return {
        "s-losing": Family(
            name="s-losing", phases=("only",), summary="", parameters=(), build=losing, robot="arm"
        ),
        "s-reach": Family(
            name="s-reach", phases=("reach",), summary="", parameters=(gravity,), build=weighed, robot="arm"
        ),
    }
