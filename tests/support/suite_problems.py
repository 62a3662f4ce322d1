"""A package of families for the suite's tests, each with its own way to end."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.problems import hop, reach
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.problem.family import Family
from trajopt.problem.problem import Problem
from trajopt.study import solves
from trajopt.terms import AccelerationCost, TerminalState, TorqueLimits

# Far below what swings the arm to its goal in time, N m.
FEEBLE = 1e-3
# The perturbed start that never comes back.
LOST_SEED = 1


def infeasible() -> Problem:
    return reach(terms=(AccelerationCost(weight=1.0), TorqueLimits(limit=np.array([FEEBLE]))))


def not_finite() -> Problem:
    """The error of a rotation has a pole at half a turn, where the guess ends."""
    turned = hop().initial_q.copy()
    turned[3:7] = [0.0, 0.0, 1.0, 0.0]
    return hop(terms=(AccelerationCost(weight=1.0), TerminalState(q=turned)))


def coarse() -> Problem:
    """Two intervals of a scheme of first order: solved, and the foot slides."""
    return hop(default_transcription="semi-implicit-euler", default_intervals=6)


def on_robot(*, robot: str) -> Problem:
    if robot not in ("one", "two"):
        raise InputError(f"robot '{robot}' is no arm", "allowed: one, two")
    return replace(reach(gravity=robot == "two"), name="t-robots")


def refused() -> Problem:
    raise InputError("the goal is on the moon", "allowed: on earth")


def broken() -> Problem:
    raise RuntimeError("first line\nsecond line")


def without_memory() -> Problem:
    raise MemoryError


def segmentation_fault() -> Problem:
    os.kill(os.getpid(), signal.SIGSEGV)
    return reach()


def killed() -> Problem:
    """What Linux does to a process when memory runs out."""
    os.kill(os.getpid(), signal.SIGKILL)
    return reach()


def hanging() -> Problem:
    time.sleep(3600)
    return reach()


def losing_a_start() -> Problem:
    """The process aborts when it comes to one of its perturbed starts."""
    original = solves.solve

    def solve(*given: Any, **settings: Any) -> Solution:
        if settings.get("seed") == LOST_SEED:
            os.abort()
        return original(*given, **settings)

    solves.solve = solve
    return reach()


BUILDERS: dict[str, Callable[..., Problem]] = {
    "t-reach": reach,
    "t-infeasible": infeasible,
    "t-not-finite": not_finite,
    "t-coarse": coarse,
    "t-refused": refused,
    "t-broken": broken,
    "t-without-memory": without_memory,
    "t-segmentation-fault": segmentation_fault,
    "t-killed": killed,
    "t-hanging": hanging,
    "t-losing-a-start": losing_a_start,
}


def _family(name: str, build: Callable[..., Problem], **robots: object) -> Family:
    return Family(name=name, phases=("only",), summary="", parameters=(), build=build, **robots)


def families() -> dict[str, Family]:
    """The families by name; one of them takes a robot."""
    found = {name: _family(name, build, robot="arm") for name, build in BUILDERS.items()}
    return {**found, "t-robots": _family("t-robots", on_robot, robots=("one", "two"))}
