"""Swing clearance: contacts in the air stay above the ground, at nodes.

The least height over a swing follows `swing_profile`, which is zero and flat at lift-off and touchdown. It
applies to the lowest point: the centre of a contact with a radius stays above the parallel surface. Over flat
and smooth ground a swing is one phase (`SwingClearance`) or spans several (`SwingArc`). Over piecewise ground
(`SwingOver`) a foot that has to pass an edge stays on its side of it until it is as high as the ground behind
it; on the way down it keeps that height until it has passed the edge. Both hold at one node at least, so
between any two nodes one of them holds at both ends, and no interval cuts the edge. All of these rows are
linear in the foot's position. `trajopt.terms.swing_planning` creates the terms for all swings of a schedule.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from typing_extensions import override

from trajopt.arguments import NonNegative, checked
from trajopt.errors import InputError
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import DuringPhases, NodeConstraint, NodePlace, Rows
from trajopt.terms.landing import along_ground, contact_points
from trajopt.terrain.crossing import Crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import UP, Surface
from trajopt.terrain.swing_paths import swing_profile
from trajopt.terrain.terrain import Terrain

LEVEL = np.array(UP)
# Rounding of times of nodes, as a fraction of a swing.
SAME_TIME = 1e-9


def _acts_at(place: NodePlace, between_phases: bool) -> bool:
    """Whether a node is the first of its phase, if ``between_phases``, or else inside it."""
    return place.index == 0 if between_phases else 0 < place.index < place.count


@checked
@dataclass(frozen=True, kw_only=True)
class SwingClearance(DuringPhases, NodeConstraint):
    """Contacts that are inactive in a phase stay above the terrain at the nodes inside the phase.

        n . p - d >= height 16 s^2 (1 - s)^2

    at the fraction s of the phase, with p the contact's point, or each of the four corners of a sole, and the
    plane n . p = d of flat ground, raised by the contact's radius. Over smooth ground the left side is the
    vertical height of p above it. Rows are over l. For piecewise ground, which has edges, use `SwingOver`.

    Args:
        height: least distance from the ground in mid swing, m.
        terrain: the ground, flat or smooth.

    Raises:
        InputError: for piecewise ground, and a height that is negative.
    """

    height: NonNegative
    terrain: Terrain

    def __post_init__(self) -> None:
        if isinstance(self.terrain, PiecewiseTerrain):
            raise InputError(
                "SwingClearance over piecewise ground, where feet would cut edges between nodes",
                "allowed: flat or smooth ground; swing_clearance() of trajopt.terms for any",
            )

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        acting = [phase for phase in schedule.phases if self.acts_in(phase.name)]
        stands = all(contact.name in phase.contacts for phase in acting for contact in robot.contacts)
        if self.phases is not None and stands:
            return f"no contact is in the air in phases {', '.join(self.phases)}"
        return ""

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return _acts_at(place, between_phases=False) and self.acts_in(place.phase.name)

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        heights = []
        for contact in context.robot.contacts:
            if contact.name in place.phase.contacts:
                continue
            ground = self.terrain.surface.offset(contact.radius)
            above = [along_ground(context, ground, point) for point in contact_points(context, contact)]
            if isinstance(ground, Surface) and ground.height:
                # Measured from the ground, not the origin: solvers relax a bound in proportion to its size.
                level = context.parameter(ground.height)
                above = [height - level for height in above]
            heights += above
        least = self.height * swing_profile(place.fraction)
        return Rows.create(ca.vertcat(*heights), least, np.inf, units.length)


@checked
@dataclass(frozen=True)
class SwingPart:
    """The part of a contact's swing in one phase: fractions of the swing where the phase begins and ends."""

    contact: str
    begin: float
    end: float


@checked
@dataclass(frozen=True, kw_only=True)
class SwingArc(NodeConstraint):
    """Swinging contacts stay above flat or smooth ground over swings that may span several phases.

        n . p - d >= height 16 s^2 (1 - s)^2

    as for `SwingClearance`, with s the fraction of the whole swing. Nothing is imposed where a swing begins
    or ends, because the contact's stance determines its position. `swing_arcs` creates these terms.

    Args:
        height: least height in mid swing, m.
        terrain: the ground.
        parts: the swings in each phase, by the phase's name.
        between_phases: the term acts where the phases begin, for the contacts that are in the air before it
            too; otherwise at the nodes inside the phases.
    """

    made_for_schedule: ClassVar[bool] = True

    height: NonNegative
    terrain: FlatGround | SmoothTerrain
    parts: Mapping[str, tuple[SwingPart, ...]]
    between_phases: bool = False

    def _acting(self, phase: str) -> list[SwingPart]:
        return [part for part in self.parts.get(phase, ()) if part.begin > 0 or not self.between_phases]

    @override
    def idle(self, robot: Robot, schedule: Schedule) -> str:
        unknown = [name for name in self.parts if name not in schedule.names]
        return f"its swings are in phase '{unknown[0]}', which does not exist" if unknown else ""

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return _acts_at(place, self.between_phases) and bool(self._acting(place.phase.name))

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        heights, least = [], []
        for part in self._acting(place.phase.name):
            contact = context.robot.contact(part.contact)
            ground, points = self.terrain.surface.offset(contact.radius), contact_points(context, contact)
            level = ground.height if isinstance(ground, Surface) else 0.0
            s = part.begin + place.fraction * (part.end - part.begin)
            heights += [along_ground(context, ground, point) for point in points]
            least += [level + self.height * swing_profile(s)] * len(points)
        return Rows.create(ca.vertcat(*heights), np.array(least), np.inf, units.length)


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class SwingCrossing:
    """One swing of a contact over piecewise ground.

    Args:
        contact: name of the contact.
        begin: nominal time of the lift-off, s.
        end: nominal time of the touchdown, s.
        parts: (begin, duration) of the phases of the swing, s, by their names.
        ground: the ground between the two footholds, raised by the contact's radius.
        risen: fraction of the swing at which the foot is at the top, before the first edge.
        sinking: fraction at which it starts to descend, behind the last edge.
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

    def half_spaces(self, place: NodePlace, height: float) -> list[tuple[np.ndarray, float]]:
        """Normals (3,) and offsets (m) of the one or two half-spaces in which the foot is at a node.

        Args:
            place: the node.
            height: clearance in mid swing, m.
        """
        ground, (s, step) = self.ground, self.fraction(place)
        lift = height * swing_profile(s)
        if ground.top is None:
            planes = [ground.first] if ground.first.same_plane(ground.last) else [ground.first, ground.last]
            return [_above(plane, lift) for plane in planes]
        half = step / 2 + SAME_TIME
        risen = min(max(self.risen, step), 1 - step)
        sinking = min(max(self.sinking, step), 1 - step)
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
        # All nodes of a swing have the same number of rows: this one is never active if the first holds.
        return [first, (LEVEL, ground.top - height)]


def _above(plane: Surface, lift: float) -> tuple[np.ndarray, float]:
    """Half-space at least ``lift`` m over a plane, measured vertically."""
    upward = float(plane.normal[2])
    return plane.normal / upward, plane.height / upward + lift


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class SwingOver(NodeConstraint):
    """Feet stay above piecewise ground over their swings, and cut no edge between the nodes.

        a_i . p >= b_i

    for the one or two half-spaces (a_i, b_i) in which the contact's point, or each corner of a sole, is at a
    node (see this module); the clearance follows `swing_profile`. Rows are over l. `swing_clearance` creates
    these terms.

    Args:
        height: clearance in mid swing, m.
        swings: all swings.
        between_phases: the term acts where one phase of a swing passes into the next; otherwise at the nodes
            inside the phases.
    """

    height: float
    swings: tuple[SwingCrossing, ...]
    between_phases: bool = False

    def _acting(self, place: NodePlace) -> Iterator[SwingCrossing]:
        for swing in self.swings:
            inside = place.phase.name in swing.parts
            if inside and (place.index > 0 or next(iter(swing.parts)) != place.phase.name):
                yield swing

    @override
    def acts_at(self, place: NodePlace) -> bool:
        return _acts_at(place, self.between_phases) and any(True for _ in self._acting(place))

    @override
    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        expressions, bounds = [], []
        for swing in self._acting(place):
            points = contact_points(context, context.robot.contact(swing.contact))
            for normal, least in swing.half_spaces(place, self.height):
                direction = context.parameter(normal)
                expressions += [ca.dot(direction, point) for point in points]
                bounds += [least] * len(points)
        return Rows.create(ca.vertcat(*expressions), np.array(bounds), np.inf, units.length)
