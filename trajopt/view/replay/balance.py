"""Centre of mass, zero-moment point and support of a motion, by numeric Pinocchio.

The external wrench on the robot (and its payload) follows from its momentum,

    F = dh/dt - m g        M_p = dk/dt + (c - p) x F

with linear and angular momentum h, k (about the centre of mass c). The zero-moment point z lies in the plane
of the contacts, of normal n: n x M_z = 0, so z = p + n x M_p / (n . F) for any p of that plane (Sardain and
Bessonnet, "Forces acting on a biped robot. Center of pressure - zero moment point", IEEE Trans. SMC A 34,
2004); forces of contacts with a radius act in their centres, and the point in the plane of these is drawn in
that of the ground. Where all loaded contacts are on one plane it is their centre of pressure. Otherwise a
virtual plane is used, level and through the mean of the contacts. Walls and handles do not support a robot
that stands on something else; their forces move the point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from trajopt.dynamics.model_quantities import mass_of
from trajopt.motion.carried import carrying_model
from trajopt.motion.touched import TouchedSurfaces
from trajopt.robot.sole import centre_of_pressure
from trajopt.solution.solution import Solution
from trajopt.terrain.surface import SAME_PLANE, UP, Surface
from trajopt.view.replay.motion import LEAST_PRESSURE, ReplayMotion
from trajopt.view.replay.surfaces import plane_of

# A surface whose normal is nearer to level than to vertical is a wall: it does not carry.
LEVEL = np.sqrt(0.5)
_CORNERS = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class SupportArea:
    """The support during frames ``rows`` (n,): a plane, and the convex hull (k, 3) of its contacts, m.

    The hull is that of the contacts' points and soles' corners along the plane's normal, in order around
    it; its points are the contacts' own, on several planes too. Two points are a segment. rise: mean height,
    m, at which forces act over the plane: of contacts with a radius in their centres.
    """

    rows: np.ndarray
    plane: Surface
    hull: np.ndarray
    rise: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """At n frames: com (n, 3), below it on the ground (n, 3), zero-moment point (n, 3), m; NaN where none."""

    com: np.ndarray
    below: np.ndarray
    zmp: np.ndarray
    supports: list[SupportArea]


def balance_of(solution: Solution, motion: ReplayMotion, touched: TouchedSurfaces) -> Balance:
    """Return the balance of a motion; ``touched`` is of its frames. Raises `SolutionFileError`."""
    com = centres_of_mass(solution, motion)
    supports = supports_of(solution, motion, touched)
    force, moment = (motion.between(part) for part in outer_wrenches(solution))
    zmp = np.full_like(com, np.nan)
    for support in supports:
        rows, plane = support.rows, support.plane
        lever = plane.point + support.rise * plane.normal
        about = moment[rows] - np.cross(lever, force[rows])
        pressed = force[rows] @ plane.normal > LEAST_PRESSURE * motion.weight
        place = plane.point + centre_of_pressure(force[rows], about, plane.normal)
        zmp[rows] = np.where(pressed[:, None], place, np.nan)
    return Balance(com=com, below=on_ground(solution, com), zmp=zmp, supports=supports)


def centres_of_mass(solution: Solution, motion: ReplayMotion) -> np.ndarray:
    """Centre of mass (n, 3) of the robot with its payload, world, m."""
    com = np.empty((motion.n_frames, 3))
    for phase in np.unique(motion.phase):
        model = carrying_model(solution, int(phase))
        data = model.createData()
        for row in np.flatnonzero(motion.phase == phase):
            com[row] = pin.centerOfMass(model, data, motion.q[row], False)
    return com


def outer_wrenches(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Force (K, 3) N and moment about the world's origin (K, 3) N m from outside at the samples."""
    force, moment, com = np.empty((3, solution.n_samples, 3))
    for phase in np.unique(solution.phase):
        model = carrying_model(solution, int(phase))
        data, weight = model.createData(), mass_of(model) * model.gravity.linear
        for row in np.flatnonzero(solution.phase == phase):
            state = (solution.q[row], solution.v[row], solution.a[row])
            rate = pin.computeCentroidalMomentumTimeVariation(model, data, *state)
            force[row], moment[row], com[row] = rate.linear - weight, rate.angular, data.com[0]
    return force, moment + np.cross(com, force)


def supports_of(solution: Solution, motion: ReplayMotion, touched: TouchedSurfaces) -> list[SupportArea]:
    """One support for each phase with loaded contacts; consecutive phases with the same are joined.

    Of contacts on the ground and on walls those on the ground.
    """
    pressing = motion.active & ~touched.bilateral
    level = touched.normal @ upward(solution.model) > LEVEL
    areas: list[SupportArea] = []
    for phase in np.unique(motion.phase):
        rows = motion.phase == phase
        middle = int(np.flatnonzero(rows)[rows.sum() // 2])
        contacts = np.flatnonzero(pressing[middle] & level[middle])
        if not len(contacts):  # nothing but steep ground
            contacts = np.flatnonzero(pressing[middle])
        if not len(contacts):
            continue
        plane = _plane(solution, motion, touched, middle, contacts)
        points = np.concatenate([_touching(solution, motion, middle, int(contact)) for contact in contacts])
        hull = _hull(points, plane)
        rise = float(solution.description.radii[contacts].mean())
        previous = areas[-1] if areas else None
        if previous is not None and previous.hull.shape == hull.shape and np.allclose(previous.hull, hull):
            areas[-1] = replace(previous, rows=previous.rows | rows, hull=hull)
        else:
            areas.append(SupportArea(rows=rows, plane=plane, hull=hull, rise=rise))
    return areas


def _plane(
    solution: Solution, motion: ReplayMotion, touched: TouchedSurfaces, row: int, contacts: np.ndarray
) -> Surface:
    """The one plane of ``contacts`` at a frame, or the virtual one."""
    normals, points = touched.normal[row, contacts], touched.point[row, contacts]
    turned = np.abs(normals - normals[0]).max() if len(contacts) else 0.0
    apart = np.abs((points - points[0]) @ normals[0]).max()
    if touched.known[row, contacts].all() and turned < SAME_PLANE and apart < SAME_PLANE:
        return Surface(point=points[0], normal=normals[0])
    return Surface(point=motion.feet[row, contacts].mean(axis=0), normal=upward(solution.model))


def upward(model: pin.Model) -> np.ndarray:
    """Unit vector (3,) against gravity; the world's z where there is none."""
    gravity = model.gravity.linear
    length = float(np.linalg.norm(gravity))
    return -gravity / length if length > 0 else np.array(UP)


def _touching(solution: Solution, motion: ReplayMotion, row: int, contact: int) -> np.ndarray:
    """Points (k, 3) of a contact in the world, m: its frame's origin, or the corners of its sole."""
    place, size = motion.contacts[row, contact], solution.description.contacts[contact].half_size
    if size is None:
        return np.asarray(place[None, :3, 3])
    return np.asarray(_CORNERS * [*size, 0.0] @ place[:3, :3].T + place[:3, 3])


def _hull(points: np.ndarray, plane: Surface) -> np.ndarray:
    """Points (k, 3) on the convex hull along the plane's normal, in order; the ends of points on a line."""
    level = (points - plane.point) @ plane.tangents.T
    try:
        return np.asarray(points[ConvexHull(level).vertices])
    except (QhullError, ValueError):  # too few, or all on one line
        way = level - level[0]
        along = way @ way[np.argmax(np.linalg.norm(way, axis=1))]
        ends = [int(np.argmin(along)), int(np.argmax(along))]
        return points[ends] if along.any() else points[:1]


def on_ground(solution: Solution, places: np.ndarray) -> np.ndarray:
    """Where vertical lines through ``places`` (n, 3) meet the terrain (n, 3), m; NaN over holes, at walls."""
    terrain = solution.description.ground
    if terrain is None or isinstance(terrain, Surface):
        plane, up = plane_of(solution), upward(solution.model)
        slope = float(plane.normal @ up)
        if slope <= SAME_PLANE:
            return np.full_like(places, np.nan)
        return np.asarray(places - plane.distance(places)[:, None] / slope * up)
    below = places.copy()
    below[:, 2] = terrain.height(places[:, 0], places[:, 1])
    return np.where(np.isfinite(below), below, np.nan)
