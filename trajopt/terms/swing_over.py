"""Swings over ground with edges: constraints at nodes that hold between them too.

A foot that has to pass an edge stays on its side of it until it is as high as the ground behind (and, going
down, keeps that height until it has passed). At one node at least both hold, so that between any two nodes
one of them holds at both ends: no interval cuts the edge. All rows are linear in the foot's position.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.errors import InputError
from trajopt.robot.kinematics import contact_poses, contact_positions
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows, Term
from trajopt.terms.landing import SwingClearance, contact_points, corners
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.terrain.crossing import Crossing, Edge, crossing
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import UP, Surface
from trajopt.terrain.swing_path import crossing_of
from trajopt.terrain.swing_profile import swing_profile
from trajopt.terrain.terrain import Ground, Terrain

# Distance kept from an edge in units of the clearance, and at most this part of what there is at lift-off.
FROM_EDGE, OF_WAY = 0.5, 0.5
# Samples of the guess's swing in which it is seen to pass an edge.
SAMPLES = 101
LEVEL = np.array(UP)
# Rounding of times of nodes, as a part of a swing.
SAME_TIME = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Swing:
    """One swing of a contact, from ``begin`` to ``end`` (nominal times, s), over what lies between.

    ``parts`` are (begin, duration) of its phases by name. ``risen`` and ``sinking`` are the fractions of its
    time at which the foot is at the top before the first edge, and still there behind the last.
    """

    contact: str
    begin: float
    end: float
    parts: dict[str, tuple[float, float]]
    ground: Crossing
    risen: float
    sinking: float

    def fraction(self, place: NodePlace) -> tuple[float, float]:
        """Fraction of the swing at a node, and that of one interval there."""
        begin, duration = self.parts[place.phase.name]
        whole = self.end - self.begin
        return (begin + place.fraction * duration - self.begin) / whole, duration * place.step / whole

    @property
    def has_two_rows(self) -> bool:
        """Whether one plane for the foot to be above is not enough."""
        ground = self.ground
        return ground.top is not None or not ground.first.same_plane(ground.last)


@dataclass(frozen=True, kw_only=True, eq=False)
class SwingOver(NodeConstraint):
    """Feet of ``swings`` stay above piecewise ground, by ``height`` times `swing_profile` m, and cut no edge.

    ``at_joints``: acts where one phase of a swing goes over into the next, else at the nodes within phases.
    Of a sole all four corners. See `swing_clearance`.
    """

    height: float
    swings: tuple[Swing, ...]
    at_joints: bool = False

    def _acting(self, place: NodePlace) -> Iterator[Swing]:
        for swing in self.swings:
            inside = place.phase.name in swing.parts
            if inside and (place.index > 0 or next(iter(swing.parts)) != place.phase.name):
                yield swing

    def acts_at(self, place: NodePlace) -> bool:
        if place.index >= place.count or (place.index == 0) != self.at_joints:
            return False
        return any(True for _ in self._acting(place))

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        expressions, bounds = [], []
        for swing in self._acting(place):
            points = contact_points(context, context.robot.contact(swing.contact))
            for normal, least in self._planes(swing, place):
                direction = context.parameter(normal)
                expressions += [ca.dot(direction, point) for point in points]
                bounds += [least] * len(points)
        return Rows.create(ca.vertcat(*expressions), np.array(bounds), np.inf, units.length)

    def _planes(self, swing: Swing, place: NodePlace) -> list[tuple[np.ndarray, float]]:
        """Normals (3,) and offsets in m of the one or two half-spaces in which the foot is at a node."""
        ground, (s, step) = swing.ground, swing.fraction(place)
        lift = self.height * swing_profile(s)
        if ground.top is None:
            planes = [ground.first, ground.last][: 1 + swing.has_two_rows]
            return [_above(plane, lift) for plane in planes]
        half = step / 2 + SAME_TIME
        risen = min(max(swing.risen, step), 1 - step)
        sinking = min(max(swing.sinking, step), 1 - step)
        if ground.rise is not None and s < risen - half:
            first = _above(ground.first, lift)
        elif ground.fall is not None and s > sinking + half:
            first = _above(ground.last, lift)
        else:
            first = (LEVEL, ground.top + lift)
        if ground.rise is not None and s <= risen + half:
            return [first, (ground.rise.normal, ground.rise.offset)]
        if ground.fall is not None and s >= sinking - half:
            return [first, (ground.fall.normal, ground.fall.offset)]
        # Nothing more to ask: a second row that the first keeps from ever being active.
        return [first, (LEVEL, ground.top - self.height)]


def _above(plane: Surface, lift: float) -> tuple[np.ndarray, float]:
    """Half-space at least ``lift`` m over a plane, measured vertically."""
    upward = float(plane.normal[2])
    return plane.normal / upward, plane.height / upward + lift


def swing_clearance(
    robot: Robot, schedule: Schedule, terrain: Terrain, *, height: float, guess: Motion
) -> tuple[Term, ...]:
    """Terms that keep swinging contacts above any terrain, by ``height`` m in mid swing.

    On flat and smooth ground `SwingClearance`. On piecewise ground `SwingOver`: ``guess`` (t -> q (nq,)) says
    from where to where each contact swings, where no foothold does, and when it passes edges. Contacts that
    do not touch again, or have not touched before, are left out. Raises `InputError`.
    """
    if not isinstance(terrain, PiecewiseTerrain):
        return (SwingClearance(height=height, terrain=terrain),)
    if not (np.isfinite(height) and height >= 0):
        raise InputError(f"swing clearance is {height:g} m", "allowed: finite and >= 0")
    swings = tuple(_swings(robot, schedule, terrain, height, guess))
    terms = [SwingOver(height=height, swings=swings)] if swings else []
    if any(len(swing.parts) > 1 for swing in swings):
        terms.append(SwingOver(height=height, swings=swings, at_joints=True))
    return tuple(terms)


def _swings(
    robot: Robot, schedule: Schedule, terrain: PiecewiseTerrain, height: float, guess: Motion
) -> Iterator[Swing]:
    times = np.concatenate([[0.0], np.cumsum([phase.duration for phase in schedule.phases])])
    for contact in robot.contacts:
        on = [contact.name in phase.contacts for phase in schedule.phases]
        for last in range(1, len(on)):
            if not on[last] or on[last - 1] or not any(on[:last]):
                continue
            first = max(i for i in range(last) if on[i]) + 1
            span = (float(times[first]), float(times[last]))
            track = _track(robot, contact.name, guess, span)
            starts = contact_positions(robot, guess(0.0))
            middles = track.mean(axis=1)
            places = [
                _touched(schedule, first - 1, contact.name, terrain, starts, middles[0]),
                _touched(schedule, last, contact.name, terrain, starts, middles[-1]),
            ]
            for end, (place, _) in zip((0, -1), places, strict=True):
                track[end] += place - middles[end]
            parts = {
                schedule.phases[i].name: (float(times[i]), schedule.phases[i].duration)
                for i in range(first, last)
            }
            yield _swing(contact.name, span, parts, terrain, places, track, height)


def _track(robot: Robot, name: str, guess: Motion, span: tuple[float, float]) -> np.ndarray:
    """Points (n, m, 3) of a contact along the guess of its swing, m: one, or a sole's four corners."""
    poses = (contact_poses(robot, guess(float(t)))[name] for t in np.linspace(*span, SAMPLES))
    points = corners(robot.contact(name))
    return np.array([pose.translation + points @ pose.rotation[:, :2].T for pose in poses])


def _touched(
    schedule: Schedule,
    index: int,
    name: str,
    terrain: PiecewiseTerrain,
    starts: dict[str, np.ndarray],
    guessed: np.ndarray,
) -> tuple[np.ndarray, Surface]:
    """Where a contact of a phase stands, as far as is known, and the plane there."""
    ground: Ground = schedule.surface(index, name, terrain, starts)
    begins = schedule.beginning(name, index)
    place = schedule.phases[begins].footholds.get(name, guessed)
    plane = ground.plane_at(place)
    place = place - float(plane.distance(place)) / plane.normal[2] * LEVEL if plane.normal[2] > 0 else place
    patch = schedule.patch(index, name)
    return (place if patch is None else patch.nearest(place)), plane


def _swing(
    name: str,
    span: tuple[float, float],
    parts: dict[str, tuple[float, float]],
    terrain: PiecewiseTerrain,
    places: list[tuple[np.ndarray, Surface]],
    track: np.ndarray,
    height: float,
) -> Swing:
    (start, first), (end, last) = places
    upward = first.normal[2] > 0 and last.normal[2] > 0
    found = crossing(terrain, start, end, first, last) if upward else crossing_of(terrain, start, end)
    rise, fall = _kept_from(found.rise, track[0], height), _kept_from(found.fall, track[-1], height)
    ground = Crossing(first=found.first, last=found.last, top=found.top, rise=rise, fall=fall)
    fractions = np.linspace(0.0, 1.0, len(track))
    risen = 0.0 if rise is None else float(fractions[_last_before(rise.distance(track))])
    sinking = 1.0 if fall is None else float(1.0 - fractions[_last_before(fall.distance(track[::-1]))])
    return Swing(
        contact=name,
        begin=span[0],
        end=span[1],
        parts=parts,
        ground=ground,
        risen=min(risen, sinking),
        sinking=max(risen, sinking),
    )


def _kept_from(edge: Edge | None, points: np.ndarray, height: float) -> Edge | None:
    """The edge with a distance to keep from it, less than all of the foot has at its end of the swing."""
    if edge is None:
        return None
    keep = min(FROM_EDGE * height, OF_WAY * max(float(edge.distance(points).min()), 0.0))
    return Edge(normal=edge.normal, offset=edge.offset + keep, part=edge.part)


def _last_before(distances: np.ndarray) -> int:
    """Last sample up to which all points of a track have stayed on the free side; ``distances`` (n, m)."""
    beyond = np.flatnonzero(distances.min(axis=1) < 0)
    return int(max(beyond[0] - 1, 0)) if len(beyond) else len(distances) - 1
