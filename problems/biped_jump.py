"""Jumps of bipeds, up and forward, from rest to rest on both feet."""

from __future__ import annotations

from problems import bipeds
from problems.quadruped_jump import family

FAMILIES = (
    family(
        "up",
        "jump straight up, land on the same places and come to rest",
        kind="biped",
        robots=bipeds.ROBOTS,
        load=bipeds.biped,
    ),
    family(
        "forward",
        "jump forward from both feet to both feet",
        kind="biped",
        robots=bipeds.ROBOTS,
        load=bipeds.biped,
    ),
)
