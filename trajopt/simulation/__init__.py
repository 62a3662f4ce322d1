"""Plans simulated in MuJoCo: the same robot, compliant contacts, and a controller that tracks the plan."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
