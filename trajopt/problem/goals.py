"""The goals of a problem as its solutions record them."""

from __future__ import annotations

from typing import Any

from trajopt.problem.problem import Problem
from trajopt.schedule.moment import start_of
from trajopt.schedule.targets import Target


def goals_meta(problem: Problem) -> list[dict[str, Any]]:
    """Goals for ``meta["goals"]`` of a problem's solutions: its terms' targets, then its footholds.

    A target is a place of a frame, for a foothold the origin of the contact's frame.
    """
    found = [target for term in problem.terms for target in term.targets()]
    for phase in problem.schedule.phases:
        for name in phase.footholds:
            contact = problem.robot.contact(name)
            place = phase.centre(contact, problem.terrain)
            found.append(Target(frame=contact.frame, position=place, at=start_of(phase.name)))
    return [target.describe() for target in found]
