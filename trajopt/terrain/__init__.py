"""The ground as geometry: one plane, plane faces with edges, or a smooth height."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
