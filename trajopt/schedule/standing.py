"""Whether every contact of a schedule has ground to stand on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.terrain import Terrain


def require_standing(
    robot: Robot, schedule: Schedule, terrain: Terrain, starts: Mapping[str, np.ndarray]
) -> None:
    """Raise `InputError` for a contact on piecewise or smooth ground that has no place to stand.

    ``starts`` (3,) m are points of the ground under contacts at the start, by name; none where the start is
    free. On piecewise ground a contact that lands needs a patch, a surface or a foothold; soles cannot stand
    on curved ground.
    """
    if isinstance(terrain, FlatGround):
        return
    for index, phase in enumerate(schedule.phases):
        for name in phase.contacts:
            if phase.own_surface(name) is not None:
                continue
            if isinstance(terrain, SmoothTerrain) and robot.contact(name).kind == "surface":
                raise InputError(
                    f"sole '{name}' stands on curved ground in phase '{phase.name}'",
                    "allowed: point contacts there, or a plane surface or patch for the sole",
                )
            if schedule.beginning(name, index) == 0 and name in starts:
                terrain.surface_at(starts[name])  # raises over a hole
            lands = name in schedule.new_contacts(index)
            if name not in phase.footholds and lands and isinstance(terrain, PiecewiseTerrain):
                raise InputError(
                    f"'{name}' lands in phase '{phase.name}', but the terrain has {len(terrain.faces)} faces",
                    "allowed: a patch, a surface or a foothold for it in that phase",
                )
