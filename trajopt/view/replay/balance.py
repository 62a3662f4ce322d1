"""Balance of a replay: centre of mass, zero-moment point and support, by numeric Pinocchio, and their marks.

The wrench of the contacts on the robot (and its payload) follows from its momentum,

    F = dh/dt - m g        M_p = dk/dt + (c - p) x F        less known wrenches

with linear and angular momentum h, k (about the centre of mass c). The zero-moment point z lies in the plane
of the contacts, of normal n: n x M_z = 0, so z = p + n x M_p / (n . F) for any p of that plane (Sardain and
Bessonnet, "Forces acting on a biped robot. Center of pressure - zero moment point", IEEE Trans. SMC A 34,
2004). Forces on contacts with a radius act at the centres of the contacts; the point in the plane of these
centres is drawn on the ground. If all supporting contacts are on one plane, it is their centre of pressure.
Otherwise a virtual plane is used, level and through the mean of the contacts. Walls and handles do not
support a robot that stands on something else; their forces move the point.
"""

from dataclasses import dataclass, replace
from typing import Any

import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.dynamics.model_quantities import mass_of
from trajopt.motion.solution import Solution
from trajopt.robot.contact import centre_of_pressure
from trajopt.terrain.bodies import outline
from trajopt.terrain.surface import SAME_PLANE, UP, Surface, frame_of_normal
from trajopt.view.replay import parts
from trajopt.view.replay.commands import Animation, hold_while_hidden
from trajopt.view.replay.motion import LEAST_PRESSURE, ReplayMotion
from trajopt.view.replay.runs import DrawnSolution
from trajopt.view.replay.surfaces import plane_of

# A surface whose normal is nearer to horizontal than to vertical is a wall, which gives no support.
LEVEL = np.sqrt(0.5)
_CORNERS = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
ZMP_COLOUR, SUPPORT_COLOUR = 0xB5179E, 0x2A9D6F
COM_TRAIL_COLOUR, PLUMB_COLOUR = 0x30343B, 0x50565F
SUPPORT_OPACITY = 0.28
# Opacity of marks through the robot, which covers them most of the time.
THROUGH = 0.75
# Over the robot's extent: radii of the ball, its projection, the zero-moment point, the vertical line, and
# half the width of a support that is a segment.
BALL, MARK, ZMP_MARK, PLUMB, SEGMENT = 0.032, 0.028, 0.024, 0.0025, 0.006
# Heights of flat marks over the drawn ground, over the robot's extent: above its grid, one above the other.
SUPPORT_LIFT, MARK_LIFT, ZMP_LIFT = 0.003, 0.0045, 0.006


@dataclass(frozen=True, kw_only=True, eq=False)
class SupportArea:
    """The support of the robot during some frames.

    Args:
        rows: which frames (n,).
        plane: of the contacts, see `balance`.
        hull: points and corners of soles (k, 3) on the convex hull of the contacts, seen along the plane's
            normal, in order, m. They keep their places on several planes. Two points are a segment.
        rise: mean height above the plane at which forces act, m: the centres of contacts with a radius.
    """

    rows: np.ndarray
    plane: Surface
    hull: np.ndarray
    rise: float


@dataclass(frozen=True, kw_only=True, eq=False)
class BalanceTrack:
    """Centre of mass, its projection on the ground and the ZMP at n frames, (n, 3) m; NaN where undefined."""

    com: np.ndarray
    below: np.ndarray
    zmp: np.ndarray
    supports: list[SupportArea]


def balance_of(solution: Solution, motion: ReplayMotion) -> BalanceTrack:
    """Return the balance of a motion. Raises `SolutionFileError`."""
    com = np.empty((motion.n_frames, 3))  # of the robot with its payload
    for phase in np.unique(motion.phase):
        model = solution.carrying_model(int(phase))
        data = model.createData()
        for row in np.flatnonzero(motion.phase == phase):
            com[row] = pin.centerOfMass(model, data, motion.q[row], False)
    supports = _supports(solution, motion)
    force, moment = (motion.between(part) for part in outer_wrenches(solution))
    zmp = np.full_like(com, np.nan)
    for support in supports:
        rows, plane = support.rows, support.plane
        lever = plane.point + support.rise * plane.normal
        about = moment[rows] - np.cross(lever, force[rows])
        pressed = force[rows] @ plane.normal > LEAST_PRESSURE * motion.weight
        place = plane.point + centre_of_pressure(force[rows], about, plane.normal)
        zmp[rows] = np.where(pressed[:, None], place, np.nan)
    return BalanceTrack(com=com, below=on_ground(solution, com), zmp=zmp, supports=supports)


def outer_wrenches(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Force (K, 3) N of the contacts and moment about the world's origin (K, 3) N m at the samples."""
    force, moment = np.empty((2, solution.n_samples, 3))
    for phase in np.unique(solution.phase):
        model = solution.carrying_model(int(phase))
        data, weight = model.createData(), mass_of(model) * model.gravity.linear
        for row in np.flatnonzero(solution.phase == phase):
            state = (solution.q[row], solution.v[row], solution.a[row])
            rate = pin.computeCentroidalMomentumTimeVariation(model, data, *state)
            force[row] = rate.linear - weight
            moment[row] = rate.angular + np.cross(data.com[0], force[row])
            for wrench in solution.description.wrenches:
                (joint, place), given = wrench.place(model), wrench.at(solution.t[row])
                force[row] -= given[:3]
                moment[row] -= given[3:] + np.cross(data.oMi[joint].act(place).translation, given[:3])
    return force, moment


def _supports(solution: Solution, motion: ReplayMotion) -> list[SupportArea]:
    """One support for each phase with unilateral contacts; consecutive phases with the same one are joined.

    Contacts on walls count only in phases without contacts on the ground.
    """
    touched = motion.touched
    pressing = motion.active & ~touched.bilateral
    level = touched.normal @ _upward(solution.model) > LEVEL
    areas: list[SupportArea] = []
    for phase in np.unique(motion.phase):
        rows = motion.phase == phase
        middle = int(np.flatnonzero(rows)[rows.sum() // 2])
        contacts = np.flatnonzero(pressing[middle] & level[middle])
        if not len(contacts):  # nothing but steep ground
            contacts = np.flatnonzero(pressing[middle])
        if not len(contacts):
            continue
        plane = _plane(solution, motion, middle, contacts)
        points = np.concatenate([_touching(solution, motion, middle, int(contact)) for contact in contacts])
        hull = _hull(points, plane)
        rise = float(solution.description.radii[contacts].mean())
        previous = areas[-1] if areas else None
        if previous is not None and previous.hull.shape == hull.shape and np.allclose(previous.hull, hull):
            areas[-1] = replace(previous, rows=previous.rows | rows, hull=hull)
        else:
            areas.append(SupportArea(rows=rows, plane=plane, hull=hull, rise=rise))
    return areas


def _plane(solution: Solution, motion: ReplayMotion, row: int, contacts: np.ndarray) -> Surface:
    """The common plane of ``contacts`` at a frame, or else the virtual one."""
    touched = motion.touched
    normals, points = touched.normal[row, contacts], touched.point[row, contacts]
    turned = np.abs(normals - normals[0]).max() if len(contacts) else 0.0
    apart = np.abs((points - points[0]) @ normals[0]).max()
    if touched.known[row, contacts].all() and turned < SAME_PLANE and apart < SAME_PLANE:
        return Surface(point=points[0], normal=normals[0])
    return Surface(point=motion.feet[row, contacts].mean(axis=0), normal=_upward(solution.model))


def _upward(model: pin.Model) -> np.ndarray:
    """Unit vector (3,) against gravity; the world's z where there is none."""
    gravity = model.gravity.linear
    length = float(np.linalg.norm(gravity))
    return -gravity / length if length > 0 else np.array(UP)


def _touching(solution: Solution, motion: ReplayMotion, row: int, contact: int) -> np.ndarray:
    """Points (k, 3) of a contact in the world, m: its frame's origin, or the corners of its sole."""
    place, size = motion.contacts[row, contact], solution.description.contacts[contact].half_size
    corners = np.zeros((1, 3)) if size is None else _CORNERS * [*size, 0.0]
    return np.asarray(corners @ place[:3, :3].T + place[:3, 3])


def _hull(points: np.ndarray, plane: Surface) -> np.ndarray:
    """Points (k, 3) on the convex hull along the plane's normal, in order; the ends of collinear points."""
    level = (points - plane.point) @ plane.tangents.T
    corners = outline(level)
    if len(corners) > 2:
        return np.asarray(points[corners])
    way = level - level[0]
    along = way @ way[np.argmax(np.linalg.norm(way, axis=1))]
    ends = [int(np.argmin(along)), int(np.argmax(along))]
    return points[ends] if along.any() else points[:1]


def on_ground(solution: Solution, places: np.ndarray) -> np.ndarray:
    """Where vertical lines through ``places`` (n, 3) meet the terrain (n, 3), m; NaN over holes and walls."""
    terrain = solution.description.ground
    if terrain is None or isinstance(terrain, Surface):
        plane, up = plane_of(solution), _upward(solution.model)
        slope = float(plane.normal @ up)
        if slope <= SAME_PLANE:
            return np.full_like(places, np.nan)
        return np.asarray(places - plane.distance(places)[:, None] / slope * up)
    below = places.copy()
    below[:, 2] = terrain.height(places[:, 0], places[:, 1])
    return np.where(np.isfinite(below), below, np.nan)


def draw_balance(
    run: DrawnSolution, tracks: Animation, balance: BalanceTrack, drop: float, size: float
) -> None:
    """Animate the marks; ``drop`` m is how far below the contacts the drawn ground lies."""
    _draw_com(run, tracks, balance, drop, size)
    if not balance.supports or not BASE_JOINT[base_of(run.solution.model)]:  # a fixed base
        return
    _draw_zmp(run, tracks, balance, drop, size)
    for number, support in enumerate(balance.supports):
        place = run.node["support"][f"stance{number}"]
        _draw_support(place, support, drop, size, run.ink(SUPPORT_COLOUR))
        tracks.add(place, "visible", support.rows)


def _draw_com(run: DrawnSolution, tracks: Animation, balance: BalanceTrack, drop: float, size: float) -> None:
    node, up = run.node["com"], _upward(run.solution.model)
    dark = parts.colour_array(run.colour) if run.tinted else parts.DARK
    ball = parts.two_tone_ball(BALL * size, dark)
    parts.draw_showing_through(node["ball"], ball, through=THROUGH, vertexColors=True)
    tracks.add(node["ball"], "position", balance.com)
    parts.draw_line(node["trail"], balance.com, run.ink(COM_TRAIL_COLOUR))
    shown = np.isfinite(balance.below).all(axis=1)
    if not shown.any():
        return
    ground = hold_while_hidden(balance.below, shown) - drop * up
    height = np.maximum((balance.com - ground) @ up, 0.0)
    turn, mark, plumb = frame_of_normal(up), node["projection"], node["plumb"]
    disc = parts.two_tone_disc(MARK * size, dark)
    parts.draw_showing_through(mark["disc"], disc, lit=False, vertexColors=True)
    mark["disc"].set_transform(parts.placed(MARK_LIFT * size * up, turn))
    tracks.show(mark, shown, position=ground)
    upright, rod = plumb["upright"], plumb["upright"]["length"]
    upright.set_transform(parts.placed(np.zeros(3), turn))
    line = shapes.MeshBasicMaterial(color=run.ink(PLUMB_COLOUR))
    parts.draw_unshadowed(rod["rod"], shapes.Cylinder(1.0, PLUMB * size), line)
    rod["rod"].set_transform(parts.placed([0.0, 0.0, 0.5], parts.UPRIGHT))
    tracks.show(plumb, shown, position=ground)
    tracks.add(rod, "scale", np.column_stack([np.ones((len(height), 2)), height]))


def _draw_zmp(run: DrawnSolution, tracks: Animation, balance: BalanceTrack, drop: float, size: float) -> None:
    shown = np.isfinite(balance.zmp).all(axis=1)
    if not shown.any():
        return
    place, turn = np.zeros_like(balance.zmp), np.tile([0.0, 0.0, 0.0, 1.0], (len(shown), 1))
    for support in balance.supports:
        normal = support.plane.normal
        place[support.rows] = balance.zmp[support.rows] + (ZMP_LIFT * size - drop) * normal
        turn[support.rows] = pin.Quaternion(support.plane.frame).coeffs()
    mark, disc = run.node["zmp"]["mark"], parts.bullseye(ZMP_MARK * size, run.ink(ZMP_COLOUR))
    parts.draw_showing_through(mark, disc, lit=False, through=THROUGH, vertexColors=True)
    tracks.show(mark, shown, position=place, quaternion=turn)


def _draw_support(node: Any, support: SupportArea, drop: float, size: float, colour: int) -> None:
    normal = support.plane.normal
    hull = support.hull + (SUPPORT_LIFT * size - drop) * normal
    if len(hull) < 2:
        return
    if len(hull) == 2:
        across = np.cross(normal, hull[1] - hull[0])
        across *= SEGMENT * size / np.linalg.norm(across)
        hull = np.array([hull[0] - across, hull[1] - across, hull[1] + across, hull[0] + across])
    area = parts.ColouredMeshGeometry.joined([(hull, normal, parts.WHITE, parts.fan(len(hull)))])
    glass = {"opacity": SUPPORT_OPACITY, "transparent": True, "depthWrite": False}
    parts.draw_unshadowed(node["area"], area, shapes.MeshBasicMaterial(color=colour, **glass))
    parts.draw_line(node["edge"], hull, colour, closed=True)
