"""From a problem to a nonlinear program: schemes, meshes, rows, derivatives, compiled code."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
