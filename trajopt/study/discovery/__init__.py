"""Discovery of contact schedules: candidates are proposed, rounded, and certified with hard contacts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
