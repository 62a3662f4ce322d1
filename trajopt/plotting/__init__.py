"""Plots of solutions: pages of panels as a picture, a document to print, or one HTML file."""

from trajopt.plotting.writing import Plotted, report

__all__ = ["Plotted", "report"]
