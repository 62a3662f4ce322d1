"""Unitree G1 with the joints of its arms and contacts at its hands."""

from .g1 import KIND as KIND
from .g1 import with_arms as build

__all__ = ["KIND", "build"]
