"""Controllers: task-space inverse dynamics that tracks a plan, and receding horizons in `control.mpc`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
