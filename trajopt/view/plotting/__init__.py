"""Plots of solutions by topic: as a picture, as a PDF with a page for each, or as one HTML file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
