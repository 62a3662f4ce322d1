"""The goals of a problem as its solutions record them."""

from __future__ import annotations

from trajopt.problem.problem import Problem
from trajopt.schedule.moment import start_of
from trajopt.schedule.targets import Target


def goals_of(problem: Problem) -> list[Target]:
    """Goals of a problem: its terms' targets, then its footholds.

    A target is a place of a frame, for a foothold the origin of the contact's frame.
    """
    targets = [target for term in problem.terms for target in term.targets()]
    for phase in problem.schedule.phases:
        for name in phase.footholds:
            contact = problem.robot.contact(name)
            place = phase.centre(contact, problem.terrain)
            targets.append(Target(frame=contact.frame, position=place, at=start_of(phase.name)))
    return targets
