"""Feet in the air stay over the ground along an arc over their whole swing, whatever phases it spans."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from trajopt.errors import InputError
from trajopt.robot.units import Units
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms.context import Context
from trajopt.terms.interfaces import Rows
from trajopt.terms.landing import along_normal, contact_points
from trajopt.terms.node_interfaces import NodeConstraint, NodePlace
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.smooth import CurvedSurface, SmoothTerrain
from trajopt.terrain.swing_profile import swing_profile


@dataclass(frozen=True)
class SwingPart:
    """What of a contact's swing lies in one phase: fractions of the swing where the phase begins and ends."""

    contact: str
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class SwingArc(NodeConstraint):
    """Swinging contacts are at least ``height`` times `swing_profile` m over the ground.

    Along the normal of flat ground; on smooth ground the height over what is under the contact. Of a sole
    all four corners.

    Of `swing_arcs`, which gives ``parts`` by phase. ``changes``: at the nodes where the phase begins, for
    the contacts that are in the air before it too; otherwise at the nodes inside the phase. Where a swing
    begins and ends nothing is asked: the contact's stance says where it is.
    """

    height: float
    terrain: FlatGround | SmoothTerrain
    parts: Mapping[str, tuple[SwingPart, ...]]
    changes: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.height) and self.height >= 0):
            raise InputError(f"swing height is {self.height:g} m", "allowed: finite and >= 0")

    def _acting(self, phase: str) -> tuple[SwingPart, ...]:
        parts = self.parts.get(phase, ())
        return tuple(part for part in parts if part.begin > 0) if self.changes else parts

    def acts_at(self, place: NodePlace) -> bool:
        inside = place.index == 0 if self.changes else 0 < place.index < place.count
        return inside and bool(self._acting(place.phase.name))

    def rows(self, context: Context, units: Units, place: NodePlace) -> Rows:
        ground, heights, least = self.terrain.surface, [], []
        for part in self._acting(place.phase.name):
            s = part.begin + place.fraction * (part.end - part.begin)
            lift = self.height * swing_profile(s)
            for point in contact_points(context, context.robot.contact(part.contact)):
                if isinstance(ground, CurvedSurface):
                    heights.append(ground.symbolic_gap(point, context.parameter))
                    least.append(lift)
                else:
                    heights.append(along_normal(context, ground, point))
                    least.append(ground.height + lift)
        return Rows.create(ca.vertcat(*heights), np.array(least), np.inf, units.length)


def swing_arcs(
    schedule: Schedule,
    contacts: tuple[str, ...],
    *,
    height: float,
    terrain: FlatGround | SmoothTerrain,
    next_name: Mapping[str, str] | None = None,
) -> tuple[SwingArc, SwingArc]:
    """Arcs ``height`` m high over the ground for every swing of ``contacts``, inside phases and between.

    next_name: of a periodic schedule, the contact whose motion a contact goes on with from the end (itself,
    or the one on the other side for half a cycle); its swings go on from the end to the beginning.
    None: the schedule begins and ends once. Raises `InputError`.
    """
    parts = _swing_parts(schedule.phases, contacts, next_name)
    arcs = [
        SwingArc(height=height, terrain=terrain, parts=parts, changes=changes) for changes in (False, True)
    ]
    return arcs[0], arcs[1]


def _swing_parts(
    phases: tuple[Phase, ...], contacts: tuple[str, ...], next_name: Mapping[str, str] | None
) -> dict[str, tuple[SwingPart, ...]]:
    found: dict[str, list[SwingPart]] = {phase.name: [] for phase in phases}
    previous = {} if next_name is None else {after: before for before, after in next_name.items()}
    for name in contacts:
        for i, phase in enumerate(phases):
            if name in phase.contacts:
                continue
            before = _time_in_air(phases[:i][::-1], name)
            if before is None:
                before = sum(p.duration for p in phases[:i])
                before += 0.0 if not previous else (_time_in_air(phases[::-1], previous[name]) or 0.0)
            after = _time_in_air(phases[i + 1 :], name)
            if after is None:
                after = sum(p.duration for p in phases[i + 1 :])
                after += 0.0 if next_name is None else (_time_in_air(phases, next_name[name]) or 0.0)
            total = before + phase.duration + after
            found[phase.name].append(SwingPart(name, before / total, (before + phase.duration) / total))
    return {name: tuple(parts) for name, parts in found.items()}


def _time_in_air(phases: tuple[Phase, ...], name: str) -> float | None:
    """Time in s from the first of these phases until the contact stands; None where it never does."""
    time = 0.0
    for phase in phases:
        if name in phase.contacts:
            return time
        time += phase.duration
    return None
