"""Mesh refinement by phase: intervals split or degrees raised until a motion is as accurate as asked for."""

from trajopt.refinement.refine import Refinement, Round, refine

__all__ = ["Refinement", "Round", "refine"]
