"""Jumps of bipeds, up and forward, from rest to rest on both feet.

As those of quadrupeds, with one more cost: a trunk on two hips swings far at little torque, and the jump
would come from this swing instead of the legs. So the distance of the base from the level one of the guess
has a cost, with a tenth of the weight on torques.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from trajopt.dynamics import gravity_of
from trajopt.problem import Family, Problem
from trajopt.robot import Units

from . import bipeds, quadruped_jump
from .gait_common import near

# Limit on the default jump forward: in flight, feet move from rest to rest with at most this acceleration
# over gravity, because a humanoid's legs are a third of its mass.
SWING_ACCELERATION = 2.0
# Default duration of the push in units of sqrt(l / g): half of a quadruped's, too short to swing.
STANCE = 1.4
# Many intervals, because bodies pitch fast above two feet.
INTERVALS = 64


def _upright(build: Callable[..., Problem], *, goal: str, **values: Any) -> Problem:
    if values["stance"] is None:
        values["stance"] = STANCE * Units(bipeds.biped(values["robot"])).time
    problem = build(goal=goal, **values)
    if goal != "effort":
        return problem
    return replace(problem, terms=(*problem.terms, near(problem.guess)), default_intervals=INTERVALS)


def _forward(build: Callable[..., Problem], **values: Any) -> Problem:
    """Limit the default distance to what heavy legs can swing through in flight."""
    problem = build(**values)
    if values["distance"] is not None:
        return problem
    flight = problem.parameters["flight"]
    most = SWING_ACCELERATION * gravity_of(problem.robot.model) * flight**2 / 4
    if problem.parameters["distance"] <= most:
        return problem
    return build(**values | {"distance": most})


def _family(direction: quadruped_jump.Direction, summary: str) -> Family:
    family = quadruped_jump.family(direction, summary, kind="biped", robots=bipeds.ROBOTS, load=bipeds.biped)
    build = partial(_upright, family.build)
    build = partial(_forward, build) if direction == "forward" else build
    # `Family` adds the parameter ``robot`` again; bipeds with jerks take up to a thousand iterations.
    return replace(family, parameters=family.parameters[1:-1], build=build)


FAMILIES = (
    _family("up", "jump straight up, land on the same places and come to rest"),
    _family("forward", "jump forward from both feet to both feet"),
)
