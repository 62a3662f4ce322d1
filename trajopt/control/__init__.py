"""Controllers that track a plan by task-space inverse dynamics with quadratic programs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
