"""The smallest problem with the same task: only what the scene requires, and a report of what was left out.

made = smallest(problem)                    from a problem
made = scene(robot, schedule, goals)        from robot, schedule and goals

print(made.report)                          what is modelled, what is not, and what that saves
solution = made.lift(trajopt.solve(made.problem))       the motion of the whole robot: to check, replay, save
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
