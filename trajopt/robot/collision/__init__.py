"""Shapes of links, obstacles, the distances between them, and planes that keep them apart."""
