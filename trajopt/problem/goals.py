"""The goals of a problem as its solutions record them."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajopt.problem.problem import Problem
from trajopt.schedule.targets import Target


def goals_meta(problem: Problem) -> list[dict[str, Any]]:
    """Goals for ``meta["goals"]`` of a problem's solutions: its terms' targets, then its footholds."""
    found = [target for term in problem.terms for target in term.targets()]
    for phase in problem.schedule.phases:
        for name, place in phase.footholds.items():
            frame = problem.robot.contact(name).frame
            found.append(Target(frame=frame, position=np.asarray(place), phase=phase.name))
    return [target.describe() for target in found]
