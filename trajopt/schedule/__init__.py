"""Contact schedules: phases and their contacts, gaits, footholds, targets of contacts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
