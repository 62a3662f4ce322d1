"""Talos with both arms and contacts at the ends of its grippers."""

from .talos import KIND as KIND
from .talos import with_arms as build

__all__ = ["KIND", "build"]
