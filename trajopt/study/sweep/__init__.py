"""The measured trade between speed and accuracy: one problem at many settings, each timed and measured."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
