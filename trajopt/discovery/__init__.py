"""Schedules that are found, not given: who touches when, proposed, rounded and certified."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
