"""Classical forms of the dynamics, to compare with: Lagrange, Newton and Euler, blocks of the mass matrix."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
