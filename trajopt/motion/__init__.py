"""Solutions, their files, and quantities along their motions: samples, carried bodies, energy."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
