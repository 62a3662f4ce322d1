"""Motions in the formats of other tools, sampled at an even rate, cycle after cycle."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
