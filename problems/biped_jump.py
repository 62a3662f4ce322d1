"""Jumps of bipeds, up and forward, from rest to rest on both feet.

As for quadrupeds, with one more cost: little torque swings a trunk far on two hips, and the jump would come
from this swing, not from the legs. So a cost of a tenth of the torques' keeps the base near the guess's,
level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from trajopt.dynamics.model_quantities import gravity_of
from trajopt.problem import Problem
from trajopt.problem.family import Family

from . import bipeds, common, quadruped_jump
from .gait_common import near

# Default forward jumps are limited to the distance of feet in flight, from rest to rest, at this fraction of
# gravity's acceleration: legs are a third of a humanoid's mass.
SWING_ACCELERATION = 2.0
# Default duration of the push in units of sqrt(l / g): half of a quadruped's, too short to swing.
STANCE = 1.4
# Bodies pitch fast over two feet.
INTERVALS = 64


def _upright(build: Callable[..., Problem], *, goal: str, **values: Any) -> Problem:
    if values["stance"] is None:
        values["stance"] = STANCE * common.natural_time(bipeds.biped(values["robot"]))
    problem = build(goal=goal, **values)
    if goal != "effort":
        return problem
    return replace(problem, terms=(*problem.terms, near(problem.guess)), default_intervals=INTERVALS)


def _forward(build: Callable[..., Problem], **values: Any) -> Problem:
    """Limits the default distance to that which heavy legs can swing during the flight."""
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
    # The family adds the parameter ``robot`` itself.
    return replace(family, parameters=family.parameters[1:], build=build)


FAMILIES = (
    _family("up", "jump straight up, land on the same places and come to rest"),
    _family("forward", "jump forward from both feet to both feet"),
)
