"""Footholds of a posture and of a schedule on terrain, and whether contacts have ground to stand on."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.patch import Patch
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.terrain import Terrain


@checked
def footholds_at(robot: Robot, q: np.ndarray, terrain: Terrain | None = None) -> dict[str, np.ndarray]:
    """Points of the ground that contacts touch at a configuration.

    Each is the frame's origin, moved by the contact's radius against the ground's normal; over a hole the
    normal is up.

    Args:
        robot: the robot.
        q: configuration (nq,).
        terrain: the ground, default level.

    Returns:
        Points (3,), world, m, by the contact's name.
    """
    ground = FlatGround() if terrain is None else terrain
    footholds = {}
    for name, place in contact_positions(robot, q).items():
        radius = robot.contact(name).radius
        level = ground.offset(radius)
        normal = np.array(level.normal) if isinstance(level, FlatGround) else level.normal(*place[:2])
        footholds[name] = place - radius * normal
    return footholds


@checked
def placed_on(schedule: Schedule, terrain: Terrain, *, free: bool = False) -> Schedule:
    """The schedule with every foothold moved vertically onto the ground.

    On piecewise terrain a contact also gets the patch under its foothold, and keeps the patch's margin from
    edges. Contacts with a surface or patch of their own stay as they are.

    Args:
        schedule: schedule with footholds.
        terrain: the ground.
        free: whether footholds are left out, so that contacts land anywhere on the faces under them (on other
            ground: anywhere).

    Raises:
        InputError: for a foothold over a hole.
    """
    return Schedule(tuple(_placed(phase, terrain, free) for phase in schedule.phases))


def _placed(phase: Phase, terrain: Terrain, free: bool) -> Phase:
    footholds: dict[str, np.ndarray] = {}
    patches: dict[str, Patch] = dict(phase.patches)
    for name, point in phase.footholds.items():
        if phase.own_surface(name) is not None:
            footholds[name] = point
            continue
        place = _onto(terrain, point, f"foothold of '{name}' in phase '{phase.name}'")
        if isinstance(terrain, PiecewiseTerrain):
            face = terrain.face_at(float(point[0]), float(point[1]))
            assert face is not None  # else `_onto` has raised
            patches[name], place = face, face.nearest(place)
        if not free:
            footholds[name] = place
    return replace(phase, footholds=footholds, patches=patches)


def _onto(terrain: Terrain, point: np.ndarray, what: str) -> np.ndarray:
    if isinstance(terrain, PiecewiseTerrain) and terrain.face_at(float(point[0]), float(point[1])) is None:
        raise InputError(
            f"{what} is over a hole at {np.round(point[:2], 6).tolist()} m",
            f"allowed: over one of the faces {', '.join(terrain.names)}",
        )
    plane = terrain.surface_at(point).plane_at(point)
    upward = np.array([0.0, 0.0, float(plane.distance(point)) / float(plane.normal[2])])
    return np.asarray(point - upward)


def landing_place(phase: Phase, contact: Contact, terrain: Terrain, point: np.ndarray) -> np.ndarray:
    """Return where a contact's frame lands (3,), m: over its foothold, else over its ground at ``point``."""
    centre = phase.centre(contact, terrain)
    if centre is not None:
        return centre
    if contact.name in phase.patches:
        return np.asarray(phase.patches[contact.name].offset(contact.radius).nearest(point))
    surface = phase.surface(contact.name, terrain, contact.radius).plane_at(point)
    return np.asarray(point - float(surface.distance(point)) * surface.normal)


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
