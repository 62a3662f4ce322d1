"""A package of families for tests of batches: one to solve, and one whose cases end as they are told to.

The second takes the folder in which its runs are noted as its robot, which a family looks up as it likes:
that reaches processes on any worker, where variables of the environment may not.
"""

import os
import signal
import time
from pathlib import Path

import numpy as np

from tests.support.problems import inertia, one_joint_arm
from trajopt.errors import InputError
from trajopt.problem.family import Choice, Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.study.processes import limit_time
from trajopt.terms import AccelerationCost, TerminalRest, TerminalState, TorqueCost, TorqueLimits

# N m: what swings the arm by 1 rad in 0.5 s needs at least 4 inertia 1 / 0.5^2.
TORQUE = 4.0 * inertia() / 0.5**2
# Seconds after which a case that hangs is ended.
SHORT = 0.5
# Seconds between two looks at a file.
LOOK = 0.02
FATES = ("solved", "hold", "hang", "killed", "killed-once", "refused", "broken")
# A case with the fate ``hold`` waits while its folder has this file.
HELD = "held"


def swing(*, goal: float, duration: float, cost: str) -> Problem:
    """The arm from rest at 0 to rest at the goal, with no more than `TORQUE`."""
    end = np.array([goal])
    costs = {"acceleration": AccelerationCost(weight=1.0), "torque": TorqueCost(weight=1.0)}
    return Problem(
        name="swing",
        robot=one_joint_arm(),
        schedule=Schedule((Phase(name="only", duration=duration),)),
        initial_q=np.zeros(1),
        terms=(
            costs[cost],
            TorqueLimits(limit=np.array([TORQUE])),
            TerminalState(q=end),
            TerminalRest(q=end),
        ),
        guess=lambda t: end * np.clip(t / duration, 0, 1),
        default_intervals=4,
    )


def fated(*, robot: str, number: float, fate: str) -> Problem:
    """A swing, if the case comes to its end."""
    folder, name = Path(robot), f"{fate}-{number:g}"
    if folder.is_dir():
        with (folder / name).open("a") as noted:
            noted.write("run\n")
    _meet(fate, folder, name)
    return swing(goal=0.1 + 0.001 * number, duration=0.8, cost="acceleration")


def _meet(fate: str, folder: Path, name: str) -> None:
    if fate == "hang":
        limit_time(SHORT)
        time.sleep(3600)
    if fate == "killed" or (fate == "killed-once" and runs(folder)[name] == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if fate == "refused":
        raise InputError("the goal is on the moon", "allowed: on earth")
    if fate == "broken":
        raise RuntimeError("first line\nsecond line")
    while fate == "hold" and (folder / HELD).exists():
        time.sleep(LOOK)


def runs(folder: Path) -> dict[str, int]:
    """How often each case of `fated` was begun, by fate and number."""
    return {path.name: path.read_text().count("run") for path in folder.iterdir() if path.name != HELD}


def families() -> dict[str, Family]:
    """The families by name."""
    found = [
        Family(
            name="t-swing",
            phases=("only",),
            summary="",
            parameters=(
                Parameter(name="goal", default=0.5, unit="rad", lower=-1.5, upper=1.5, meaning=""),
                Parameter(name="duration", default=0.8, unit="s", lower=0.1, upper=2.0, meaning=""),
                Choice(name="cost", default="acceleration", choices=("acceleration", "torque"), meaning=""),
            ),
            build=swing,
            robot="arm",
        ),
        Family(
            name="t-fated",
            phases=("only",),
            summary="",
            parameters=(
                Parameter(name="number", default=0.0, unit="", lower=0.0, upper=1000.0, meaning=""),
                Choice(name="fate", default="solved", choices=FATES, meaning=""),
            ),
            build=fated,
            robots=("nowhere",),
        ),
    ]
    return {family.name: family for family in found}
