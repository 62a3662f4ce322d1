"""Torques only if a term asks for them."""

from __future__ import annotations

from dataclasses import replace

from trajopt.problem.problem import Problem
from trajopt.reduced.scenes.asked import Reader


def torque_users(problem: Problem) -> tuple[str, ...]:
    """Names of the terms that use joint torques."""
    unactuated = problem.robot.n_unactuated
    found = [
        asked.term.name
        for asked in Reader(problem).every(dynamics=False)
        if asked.uses_dynamics and asked.uses(asked.context.generalized_forces[unactuated:])
    ]
    return tuple(dict.fromkeys(found))


def without_torques(problem: Problem) -> Problem | None:
    """Return the problem with accelerations as inputs, or None if a term asks for torques.

    Torques are no unknowns: the motion decides them. Without a term about them the problem is the same, and
    its functions are smaller: joint rows of the dynamics are not evaluated.
    """
    if problem.actuation != "torque" or torque_users(problem):
        return None
    return replace(problem, actuation="acceleration")
