"""From a problem to a solution: one call, warm starts, sequences, refinement, references."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
