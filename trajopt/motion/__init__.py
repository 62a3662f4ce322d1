"""Quantities along a motion: samples, carried bodies, touched surfaces, periodic images, energy."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
