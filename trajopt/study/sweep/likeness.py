"""Kinds of motion: fronts apply to problems of the same kind."""

from __future__ import annotations

from trajopt.problem.problem import Problem


def motion_kind(problem: Problem) -> str:
    """``arm`` (a fixed base), ``gait`` (periodic), ``flight`` (a phase without contacts) or ``stance``."""
    if problem.robot.base == "fixed":
        return "arm"
    if problem.periodicity is not None:
        return "gait"
    flies = any(not phase.contacts for phase in problem.schedule.phases)
    return "flight" if flies else "stance"
