"""Numbers that are none, wherever a problem takes one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.extremes.changed_robots import solo, ur5
from tests.extremes.moves import reach, stance
from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.schedule import middle_of
from trajopt.schedule.schedule import Phase
from trajopt.solving.solving import prepare
from trajopt.terms import (
    FrameHeight,
    FramePose,
    FrameVelocity,
    FrictionCone,
    PostureCost,
    SwingClearance,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface
from trajopt_library import problems, robots

NAN, INF = float("nan"), float("inf")
Make = Callable[[float], object]


def arm_problem(**changes: object) -> Problem:
    return replace(reach(ur5(), ur5().reference, ur5().reference), **changes)


def ending(term: object) -> Problem:
    return arm_problem(terms=(TorqueCost(weight=1.0), term))


def spoiled(array: np.ndarray, value: float) -> np.ndarray:
    other = np.array(array, dtype=float)
    other.flat[-1] = value
    return other


Q = np.zeros(6)
HEIGHT = "frame's height"
PLACES: dict[str, tuple[str, Make]] = {
    "initial_q": ("initial_q of Problem .*finite numbers", lambda x: arm_problem(initial_q=spoiled(Q, x))),
    "initial_v": ("initial_v of Problem .*finite numbers", lambda x: arm_problem(initial_v=spoiled(Q, x))),
    "goal": ("q of TerminalState .*finite numbers", lambda x: ending(TerminalState(q=spoiled(Q, x)))),
    "rest": ("q of TerminalRest .*finite numbers", lambda x: ending(TerminalRest(q=spoiled(Q, x)))),
    "frame": (
        "position of FramePose .*finite numbers",
        lambda x: ending(FramePose(frame="tool0", position=[0.3, 0.0, x])),
    ),
    "frame's rotation": (
        "rotation of FramePose .*finite numbers",
        lambda x: ending(FramePose(frame="tool0", rotation=spoiled(np.eye(3), x))),
    ),
    "frame's velocity": (
        "velocity of FrameVelocity .*finite numbers",
        lambda x: ending(FrameVelocity(frame="tool0", velocity=spoiled(Q, x))),
    ),
    HEIGHT: (
        "height of FrameHeight .*finite number",
        lambda x: ending(FrameHeight(frame="tool0", height=x, at=middle_of("reach"))),
    ),
    "posture": (
        "q of PostureCost .*finite numbers",
        lambda x: ending(PostureCost(weight=1.0, q=spoiled(Q, x))),
    ),
    "weight": ("weight of TorqueCost .*finite number", lambda x: TorqueCost(weight=x)),
    "friction": ("friction of FrictionCone .*finite number", lambda x: FrictionCone(friction=x)),
    "ground's friction": ("friction of FlatGround .*finite number", lambda x: FlatGround(friction=x)),
    "ground's height": ("height of FlatGround .*finite number", lambda x: FlatGround(height=x)),
    "ground's normal": (
        "normal of FlatGround .*finite numbers",
        lambda x: FlatGround(normal=np.array([0.0, 0.0, x])),
    ),
    "surface": ("normal of Surface", lambda x: Surface(point=np.zeros(3), normal=[0.0, x, 1.0])),
    "foothold": (
        r"footholds\['FL_FOOT'\] of Phase 'p' is .* finite numbers",
        lambda x: Phase(name="p", duration=1.0, contacts=("FL_FOOT",), footholds={"FL_FOOT": [0.0, x, 0.0]}),
    ),
    "duration": ("duration of Phase .*finite number", lambda x: Phase(name="p", duration=x)),
    "duration bounds": (
        "duration_bounds of Phase .*finite numbers",
        lambda x: Phase(name="p", duration=1.0, duration_bounds=(0.5, x)),
    ),
    "clearance": ("height of SwingClearance", lambda x: SwingClearance(height=x, terrain=FlatGround())),
    "reference": ("reference of Robot 'ur5'", lambda x: replace(ur5(), reference=spoiled(Q, x))),
}


def refused(cause: str, make: Callable[[], Problem]) -> None:
    """As `assert_outcome` with `Refused`, but in this process: nothing here is solved."""
    with pytest.raises(InputError, match=cause) as caught:
        prepare(make(), intervals=2)
    assert caught.value.allowed
    assert "\n" not in str(caught.value)


# A frame that must be above -inf is not bound at all.
NONE = [(where, value) for where in PLACES for value in (NAN, INF, -INF) if (where, value) != (HEIGHT, -INF)]


@pytest.mark.parametrize(("where", "value"), NONE, ids=str)
def test_an_invalid_number_is_refused_where_it_is_given(where, value):
    """By the time it is built, or where its rows are; in one line that says what is allowed."""
    cause, make = PLACES[where]

    def build() -> Problem:
        made = make(value)
        return made if isinstance(made, Problem) else arm_problem()

    refused(cause, build)


@pytest.mark.parametrize("limit", [[NAN] * 6, [1.0] * 5 + [-1.0], [1.0] * 5])
def test_invalid_torque_limits_are_refused(limit):
    refused("torque_limits|limit of TorqueLimits", lambda: ending(TorqueLimits(limit=np.array(limit))))


# How a guess may be wrong after 0.5 s, and what is said of it.
GUESSES: dict[str, tuple[str, Callable[[np.ndarray], object]]] = {
    "nan": ("is not finite", lambda q: q * NAN),
    "inf": ("is not finite", lambda q: q + INF),
    "none": (r"is of shape \(\)", lambda q: None),
    "words": ("is not numeric", lambda q: ["up"] * len(q)),
    "short": (r"is of shape \(\d+,\)", lambda q: q[:-1]),
}


@pytest.mark.long
@pytest.mark.parametrize("how", GUESSES)
@pytest.mark.parametrize("name", ["ur5", "solo12"])
def test_an_invalid_guess_is_refused_with_its_time(name, how):
    robot = robots.load(name)
    cause, wrong = GUESSES[how]
    q = robot.reference
    problem = reach(robot, q, q) if name == "ur5" else stance(robot, q, duration=1.0)
    broken = replace(problem, guess=lambda t: q if t < 0.7 else wrong(q))
    refused(rf"guess of problem '\w+' at t = 0\.[789]\d* s {cause}", lambda: broken)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_an_invalid_quaternion_is_refused(quaternion):
    q = solo().reference.copy()
    q[3:7] = quaternion
    good = solo().reference
    unit = "quaternion .* not unit; allowed: norm 1"
    refused(f"initial_q .* {unit}", lambda: stance(solo(), q, good, guess=lambda t: good))
    refused(f"terminal_state .* {unit}", lambda: stance(solo(), good, q, guess=lambda t: good))
    refused(f"guess .* {unit}", lambda: stance(solo(), good, guess=lambda t: q))


def parameters() -> list[tuple[str, str]]:
    """Every numeric parameter of every family of the library."""
    return [
        (family.name, parameter.name)
        for family in problems.families().values()
        for parameter in family.parameters
        if isinstance(parameter.lower, float | int)
    ]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400"])
def test_no_parameter_of_any_problem_takes_an_invalid_number(value):
    for name, parameter in parameters():
        with pytest.raises(InputError, match=rf"parameter {parameter}\b.*; allowed: "):
            problems.load(name, **{parameter: value})
