"""Reduced models and two-stage locomotion: pendulum, one rigid body, base rows alone."""
