"""Plots of solutions: pages of panels as a picture, a document to print, or one HTML file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
