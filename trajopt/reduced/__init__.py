"""Reduced models: paths of base and feet as guesses, plans by one body or a pendulum, smallest scenes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
