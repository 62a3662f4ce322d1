"""The problem as data: robot, schedule, terms and guess; families with parameters and their catalogue."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
