"""Only what the scene requires: the smallest problem with the same task, and what was left out and why.

made = smallest(problem)                    from a problem
made = scene(robot, schedule, goals)        from robot, schedule and goals

print(made.report)                          what is modelled, what is not, and what that saves
solution = made.lift(trajopt.solve(made.problem))       of the whole robot: to check, replay, save
"""

from __future__ import annotations

from trajopt.reduced.scenes.goals import scene
from trajopt.reduced.scenes.report import Decision, SceneReport, Size
from trajopt.reduced.scenes.smallest import Scene, size_of, smallest

__all__ = ["Decision", "Scene", "SceneReport", "Size", "scene", "size_of", "smallest"]
