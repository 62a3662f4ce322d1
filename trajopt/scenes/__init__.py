"""Only what the scene requires: the smallest problem with the same task, what was left out, and why.

made = smallest(problem)                    from a problem
made = scene(robot, schedule, goals)        from robot, schedule and goals

print(made.report)                          what is modelled, what is not, and what that saves
solution = made.lift(trajopt.solve(made.problem))       of the whole robot: to check, replay, save
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
