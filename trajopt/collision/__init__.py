"""Shapes of links, obstacles, the distances between them, and planes that keep them apart."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
