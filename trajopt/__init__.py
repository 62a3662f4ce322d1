"""Trajectory optimisation for robots with contacts.

    problem = trajopt.load("solo12-jump", distance=0.3)     a problem of the catalogue
    solution = trajopt.solve(problem)                       its solution, which states whether it succeeded
    report = trajopt.check(solution)                        recomputed with numeric Pinocchio alone
    trajopt.replay(solution)                                in the browser

Names are loaded on first use: `import trajopt` alone imports neither CasADi nor Pinocchio. The
rooms of the library, in the order in which they build on each other, are in docs/architecture.md.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
