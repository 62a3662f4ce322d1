"""Plots of solutions: pages of panels as a picture, a document to print, or one HTML file."""
