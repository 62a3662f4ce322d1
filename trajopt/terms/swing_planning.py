"""Swing terms for a whole schedule: which contacts swing when, and over what ground."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from trajopt.arguments import NonNegative, checked
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import footholds_at
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terms.interfaces import Term
from trajopt.terms.swing import LEVEL, SwingArc, SwingClearance, SwingCrossing, SwingOver, SwingPart
from trajopt.terrain.crossing import crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.smooth import SmoothTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.swing_paths import crossing_of
from trajopt.terrain.terrain import Terrain

# Number of samples along the guess's swing, to find where it passes an edge.
SAMPLES = 101


@checked
def swing_clearance(
    robot: Robot, schedule: Schedule, terrain: Terrain, *, height: NonNegative, guess: Motion
) -> tuple[Term, ...]:
    """Terms that keep swinging contacts above any terrain: `SwingClearance`, or `SwingOver` if it has edges.

    On piecewise ground, swings without a stance before or after them are left out.

    Args:
        robot: the robot.
        schedule: contacts over time.
        terrain: the ground.
        height: clearance in mid swing, m.
        guess: motion t -> q (nq,). On piecewise ground it gives the start and end of each contact's swing
            where no foothold does, and the times at which the contact passes edges.

    Raises:
        InputError: for a clearance that is negative or not finite.
    """
    if not isinstance(terrain, PiecewiseTerrain):
        return (SwingClearance(height=height, terrain=terrain),)
    swings = tuple(_swings(robot, schedule, terrain, height, guess))
    terms = [SwingOver(height=height, swings=swings)] if swings else []
    if any(len(swing.parts) > 1 for swing in swings):
        terms.append(SwingOver(height=height, swings=swings, between_phases=True))
    return tuple(terms)


def _swings(
    robot: Robot, schedule: Schedule, terrain: PiecewiseTerrain, height: float, guess: Motion
) -> Iterator[SwingCrossing]:
    times = np.concatenate([[0.0], np.cumsum([phase.duration for phase in schedule.phases])])
    for contact in robot.contacts:
        on = [contact.name in phase.contacts for phase in schedule.phases]
        for last in range(1, len(on)):
            if not on[last] or on[last - 1] or not any(on[:last]):
                continue
            first = max(i for i in range(last) if on[i]) + 1
            span = (float(times[first]), float(times[last]))
            poses = (contact_poses(robot, guess(float(t)))[contact.name] for t in np.linspace(*span, SAMPLES))
            # Points (n, m, 3) of the contact along the guess of its swing: one, or a sole's four corners.
            track = np.array([pose.translation + contact.corners @ pose.rotation[:, :2].T for pose in poses])
            starts = footholds_at(robot, guess(0.0), terrain)
            middles = track.mean(axis=1)
            places = [
                _place(schedule, first - 1, contact, terrain, starts, middles[0]),
                _place(schedule, last, contact, terrain, starts, middles[-1]),
            ]
            for end, (place, _) in zip((0, -1), places, strict=True):
                track[end] += place - middles[end]
            parts = {
                schedule.phases[i].name: (float(times[i]), schedule.phases[i].duration)
                for i in range(first, last)
            }
            yield _swing(contact, span, parts, terrain, places, track, height)


def _place(
    schedule: Schedule,
    index: int,
    contact: Contact,
    terrain: PiecewiseTerrain,
    starts: dict[str, np.ndarray],
    guessed: np.ndarray,
) -> tuple[np.ndarray, Surface]:
    """Where a contact of a phase stands, if known, and the plane that it touches there."""
    name, radius = contact.name, contact.radius
    centre = schedule.phases[schedule.beginning(name, index)].centre(contact, terrain)
    place = guessed if centre is None else centre
    plane = schedule.surface(index, name, terrain, starts).plane_at(place)
    above = plane.offset(radius)
    place = place - float(above.distance(place)) / above.normal[2] * LEVEL if above.normal[2] > 0 else place
    patch = schedule.patch(index, name)
    return (place if patch is None else patch.offset(radius).nearest(place)), plane


def _swing(
    contact: Contact,
    span: tuple[float, float],
    parts: dict[str, tuple[float, float]],
    terrain: PiecewiseTerrain,
    places: list[tuple[np.ndarray, Surface]],
    track: np.ndarray,
    height: float,
) -> SwingCrossing:
    (start, first), (end, last) = places
    upward = first.normal[2] > 0 and last.normal[2] > 0
    crossed = crossing(terrain, start, end, first, last) if upward else crossing_of(terrain, start, end)
    raised = crossed.offset(contact.radius, start, end)
    rise, fall = (
        edge and edge.kept_from(points, height, contact.radius)
        for edge, points in ((crossed.rise, track[0]), (crossed.fall, track[-1]))
    )
    ground = replace(raised, rise=rise, fall=fall)
    fractions = np.linspace(0.0, 1.0, len(track))
    risen = 0.0 if rise is None else float(fractions[_last_before(rise.distance(track))])
    sinking = 1.0 if fall is None else float(1.0 - fractions[_last_before(fall.distance(track[::-1]))])
    return SwingCrossing(
        contact=contact.name,
        begin=span[0],
        end=span[1],
        parts=parts,
        ground=ground,
        risen=min(risen, sinking),
        sinking=max(risen, sinking),
    )


def _last_before(distances: np.ndarray) -> int:
    """Last sample up to which all points of a track have stayed on the free side; ``distances`` (n, m)."""
    beyond = np.flatnonzero(distances.min(axis=1) < 0)
    return int(max(beyond[0] - 1, 0)) if len(beyond) else len(distances) - 1


@checked
def swing_arcs(
    schedule: Schedule,
    contacts: tuple[str, ...],
    *,
    height: float,
    terrain: FlatGround | SmoothTerrain,
    next_name: Mapping[str, str] | None = None,
) -> tuple[SwingArc, SwingArc]:
    """Terms for the swings of contacts, which may span phases: inside the phases and between them.

    Args:
        schedule: contacts over time.
        contacts: names of the contacts.
        height: clearance in mid swing, m.
        terrain: flat or smooth ground.
        next_name: for a periodic schedule, the contact whose motion each contact continues after the end:
            itself, or for half a cycle the one on the other side. Swings then continue from the end to the
            beginning. None for a schedule that is not periodic.

    Raises:
        InputError: for a clearance that is negative or not finite.
    """
    parts = _swing_parts(schedule.phases, contacts, next_name)
    arc = SwingArc(height=height, terrain=terrain, parts=parts)
    return arc, replace(arc, between_phases=True)


def _swing_parts(
    phases: tuple[Phase, ...], contacts: tuple[str, ...], next_name: Mapping[str, str] | None
) -> dict[str, tuple[SwingPart, ...]]:
    swings: dict[str, list[SwingPart]] = {phase.name: [] for phase in phases}
    previous = {} if next_name is None else {after: before for before, after in next_name.items()}
    for name in contacts:
        for i, phase in enumerate(phases):
            if name in phase.contacts:
                continue
            before = _time_in_air(phases[:i][::-1], name)
            if before is None:
                earlier = (_time_in_air(phases[::-1], previous[name]) or 0.0) if previous else 0.0
                before = sum(p.duration for p in phases[:i]) + earlier
            after = _time_in_air(phases[i + 1 :], name)
            if after is None:
                later = (_time_in_air(phases, next_name[name]) or 0.0) if next_name else 0.0
                after = sum(p.duration for p in phases[i + 1 :]) + later
            total = before + phase.duration + after
            swings[phase.name].append(SwingPart(name, before / total, (before + phase.duration) / total))
    return {name: tuple(parts) for name, parts in swings.items()}


def _time_in_air(phases: tuple[Phase, ...], name: str) -> float | None:
    time = 0.0
    for phase in phases:
        if name in phase.contacts:
            return time
        time += phase.duration
    return None
