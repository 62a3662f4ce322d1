"""Numeric contact dynamics: forward and inverse dynamics, impacts, and the rank of contact rows."""
