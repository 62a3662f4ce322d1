"""Smaller models: two stages, one rigid body, the pendulum; guesses and scenes made from them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
