"""Geometry that a robot may touch in a simulation: terrain, boards of single phases, obstacles.

A point contact is a ball so small (`BALL` of the reach) that its rolling is negligible; a sole has one at
each corner. The ground below them is shifted along its normal, so that a planned contact with a radius turns
about its centre; a contact that rolls is a ball of that radius. Links touch the ground where it is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajopt.collision.shapes import BoxObstacle, LinkShape, Obstacle
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.bodies import Bodies, body_name, mujoco_quaternion
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.site import BALL, Board, Site
from trajopt.terrain.bodies import solids_within
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface, frame_of_normal

# Thickness of the ground, in reaches.
DEPTH = 1.0
# Margin of a board around the contacts on it, in reaches.
BOARD = 0.1
# Size of the cells of smooth ground, in reaches, and largest number of cells along a side.
CELL = 1e-2
MOST_CELLS = 500


@dataclass(frozen=True, kw_only=True)
class GroundGeometry:
    """Geoms of the ground, and what may touch them.

    Args:
        friction: (phases, geoms, nc) of each contact on each geom, in each phase of the file.
        touched_by: the contacts that may touch each geom.
        links: offset, m, of the ground of the links that may touch each geom; None if no link may.
    """

    names: tuple[str, ...]
    friction: np.ndarray
    touched_by: tuple[tuple[int, ...], ...]
    links: tuple[float | None, ...]


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Where the contacts of a site touch, and how high the ground under them is, with given settings.

    Args:
        site: the site.
        rolling: whether each contact (nc,) is a ball that rolls.
        offsets: by how much the ground of each contact is higher than planned (nc,), m.
    """

    site: Site
    rolling: np.ndarray
    offsets: np.ndarray

    @property
    def radii(self) -> np.ndarray:
        """Radii (nc,) of the contacts as planned, m."""
        return self.site.robot.description.radii

    @property
    def reach(self) -> float:
        """The robot's reach, m."""
        return self.site.robot.units.length

    @property
    def ball(self) -> float:
        """Radius, m, of the balls of links and of contacts that do not roll."""
        return BALL * self.reach

    @property
    def sizes(self) -> np.ndarray:
        """Radii (nc,) of the balls of contacts, m."""
        return np.where(self.rolling, self.radii, self.ball)

    @property
    def lifts(self) -> np.ndarray:
        """Height (nc,), m, above the planned ground of the ground that each contact's balls touch."""
        return self.radii - self.sizes + self.offsets


def surroundings_of(site: Site, settings: SimulationSettings) -> Surroundings:
    """Sizes in a scene with these settings."""
    about = site.robot.description
    return Surroundings(
        site=site,
        rolling=about.rolling if settings.rolling is None else settings.rolling & (about.radii > 0),
        offsets=np.array([settings.ground_offsets.get(name, 0.0) for name in about.frames]),
    )


def add_geom(body: Any, name: str, kind: str, **fields: Any) -> str:
    """Add a geom of a ``kind`` ("sphere", "box", ...) that collides only in named pairs; returns its name."""
    shape = getattr(mujoco_package().mjtGeom, f"mjGEOM_{kind.upper()}")
    body.add_geom(name=name, type=shape, contype=0, conaffinity=0, **fields)
    return name


def add_ground(spec: Any, place: Surroundings) -> GroundGeometry:
    """Add terrain and boards to a specification; terrain for links, and for contacts at each height."""
    geoms: list[tuple[str, Surface | None, tuple[float, ...], tuple[int, ...], float | None]] = []
    site, about = place.site, place.site.robot.description
    usual = tuple(contact.friction for contact in about.contacts)
    count = len(usual)
    layers: list[tuple[str, float, tuple[int, ...], float | None]] = [("", 0.0, (), 0.0)]
    for lift, contacts in _by_lift(site.standing, place):
        layers.append((f".{len(layers)}", lift, contacts, None))
    for offset in np.unique(place.offsets[place.offsets != 0.0]).tolist():
        layers.append((f".{len(layers)}", offset, (), offset))
    for suffix, lift, contacts, links in layers:
        for name, plane, mu in _terrain(spec, about.ground, suffix, lift, place):
            geoms.append((name, plane, usual if mu is None else (mu,) * count, contacts, links))
    for board in site.boards:
        for lift, contacts in _by_lift(board.contacts, place):
            name = _board(spec, f"board{len(geoms)}", board, lift, place)
            geoms.append((name, board.surface, (board.surface.friction,) * count, contacts, None))
    names, planes, friction, touched_by, of_links = zip(*geoms, strict=True) if geoms else ((),) * 5
    by_phase = _by_phase(site, planes, np.array(friction, dtype=float).reshape(len(names), count))
    return GroundGeometry(names=names, friction=by_phase, touched_by=touched_by, links=of_links)


def _by_lift(contacts: Sequence[int], place: Surroundings) -> list[tuple[float, tuple[int, ...]]]:
    """Group contacts by how far their ground is above the planned one."""
    return [
        (float(lift), tuple(contact for contact in contacts if place.lifts[contact] == lift))
        for lift in np.unique(place.lifts[list(contacts)])
    ]


def _terrain(
    spec: Any,
    terrain: Surface | PiecewiseTerrain | SmoothTerrain | None,
    suffix: str,
    lift: float,
    place: Surroundings,
) -> Iterator[tuple[str, Surface | None, float | None]]:
    """Add terrain, lifted ``lift`` m along its normal; yields names, planes, friction if not per contact."""
    if isinstance(terrain, Surface):
        yield _plane(spec, f"terrain{suffix}", terrain, lift), terrain, None
    elif isinstance(terrain, PiecewiseTerrain):
        solids = solids_within(terrain, place.site.low, place.site.high, DEPTH * place.reach)
        for number, (face, solid) in enumerate(solids):
            name = _solid(spec, f"face{number}{suffix}", solid + lift * face.surface.normal)
            yield name, face.surface, face.surface.friction
    elif isinstance(terrain, SmoothTerrain):
        yield _field(spec, f"terrain{suffix}", terrain, lift, place), None, terrain.friction


def _by_phase(site: Site, planes: Sequence[Surface | None], usual: np.ndarray) -> np.ndarray:
    """Friction (phases, geoms, nc): ``usual`` (geoms, nc) unless a phase sets it for a geom's plane.

    A contact in the air has the friction of its next stance, since it may touch down early.
    """
    about, count = site.robot.description, len(site.models)
    friction, frames = np.tile(usual, (count, 1, 1)), list(about.frames)
    for phase, surfaces in enumerate(about.surfaces):
        for frame, surface in surfaces.items():
            for geom, plane in enumerate(planes):
                if not surface.bilateral and surface.same_plane(plane):
                    friction[phase, geom, frames.index(frame)] = surface.friction
    for phase in reversed(range(count - 1)):
        swings = site.swings[phase]
        friction[phase][:, swings] = friction[phase + 1][:, swings]
    return friction


def _plane(spec: Any, name: str, surface: Surface, lift: float) -> str:
    return add_geom(
        spec.worldbody,
        name,
        "plane",
        pos=surface.point + lift * surface.normal,
        quat=mujoco_quaternion(surface.frame),
        size=[0.0, 0.0, 1.0],
    )


def _solid(spec: Any, name: str, corners: np.ndarray) -> str:
    """Add the convex hull of ``corners`` (n, 3) m, world, that a solid of the ground is; returns its name."""
    middle = corners.mean(axis=0)
    mesh = spec.add_mesh(name=name, uservert=(corners - middle).ravel())
    mesh.inertia = mujoco_package().mjtMeshInertia.mjMESH_INERTIA_CONVEX
    return add_geom(spec.worldbody, name, "mesh", meshname=name, pos=middle)


def _field(spec: Any, name: str, terrain: SmoothTerrain, lift: float, place: Surroundings) -> str:
    """Add smooth ground as a height field around the motion."""
    span = (place.site.high - place.site.low)[:2]
    cells = np.minimum(np.ceil(span / (CELL * place.reach)).astype(int), MOST_CELLS)
    x, y = (np.linspace(place.site.low[i], place.site.high[i], cells[i] + 1) for i in (0, 1))
    across, along = np.meshgrid(x, y)  # rows go along y, as MuJoCo has it
    normal = terrain.normal(across, along)
    height = terrain.height(across, along) + lift / normal[..., 2]
    low, tall = float(height.min()), max(float(np.ptp(height)), 1e-6)
    spec.add_hfield(
        name=name,
        nrow=len(y),
        ncol=len(x),
        size=[span[0] / 2, span[1] / 2, tall, DEPTH * place.reach],
        userdata=((height - low) / tall).ravel(),
    )
    middle = [*(place.site.low[:2] + span / 2), low]
    return add_geom(spec.worldbody, name, "hfield", hfieldname=name, pos=middle)


def _board(spec: Any, name: str, board: Board, lift: float, place: Surroundings) -> str:
    """Add a box whose front is the board's plane, around the points where it is touched."""
    surface, turn = board.surface, frame_of_normal(board.surface.normal)
    local = (board.points - surface.point) @ turn[:, :2]
    low, high = local.min(axis=0) - BOARD * place.reach, local.max(axis=0) + BOARD * place.reach
    deep = BOARD * place.reach
    centre = surface.point + turn @ np.array([*(low + high) / 2, -deep + lift])
    size = [*(high - low) / 2, deep]
    return add_geom(spec.worldbody, name, "box", pos=centre, quat=mujoco_quaternion(turn), size=size)


def add_obstacles(spec: Any, obstacles: Sequence[Obstacle]) -> tuple[str, ...]:
    """Add obstacles of collision avoidance; returns the names of their geoms."""
    world, names = spec.worldbody, []
    for number, obstacle in enumerate(obstacles):
        name = f"obstacle{number}"
        if isinstance(obstacle, BoxObstacle):
            turn, size = mujoco_quaternion(obstacle.turn), obstacle.sides / 2
            names.append(add_geom(world, name, "box", pos=obstacle.position, quat=turn, size=size))
        else:
            names.append(add_capsule(world, name, *obstacle.axis, obstacle.radius))
    return tuple(names)


def add_shape(bodies: Bodies, shape: LinkShape, name: str) -> str:
    """Add a link's shape as a geom, hulls without their small radius; returns its name."""
    frame = bodies.model.frames[bodies.model.getFrameId(shape.frame)]
    body, within = bodies.spec.body(body_name(frame.parentJoint)), frame.placement
    points = shape.points @ within.rotation.T + within.translation
    if len(points) <= 2:
        return add_capsule(body, name, points[0], points[-1], shape.radius)
    bodies.spec.add_mesh(name=name, uservert=points.ravel())
    return add_geom(body, name, "mesh", meshname=name)


def add_capsule(body: Any, name: str, start: np.ndarray, end: np.ndarray, radius: float) -> str:
    """Add a capsule, or a ball if its segment has no length; returns its name."""
    size = [radius, 0, 0]
    if np.allclose(start, end):
        return add_geom(body, name, "sphere", pos=start, size=size)
    return add_geom(body, name, "capsule", fromto=np.concatenate([start, end]), size=size)
