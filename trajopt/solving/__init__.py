"""Solve a problem: in one call, from a warm start, as a sequence, with refinement; and say why it failed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
