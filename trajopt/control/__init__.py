"""Controllers that track a plan: task-space inverse dynamics by quadratic programs, knowing no simulator."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
