"""Trajectory optimisation for robots with contacts."""

from trajopt.versions import check_installation

check_installation()

__version__ = "0.1.0"
