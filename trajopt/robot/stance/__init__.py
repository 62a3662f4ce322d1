"""Phases in minimal coordinates: re-rooted models of a stance, their maps, and transitions to them."""
