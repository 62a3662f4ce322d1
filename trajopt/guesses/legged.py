"""One guess for all legged motions: base on a path, feet on footholds, legs by inverse kinematics."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.errors import require_finite
from trajopt.guesses.base_path import SAME_TIME, BaseWaypoint, WaypointPath, flights, turn_to_heading
from trajopt.pickling import picklable
from trajopt.problem.guessing import RememberedMotion
from trajopt.robot.kinematics import contact_poses, contact_targets, inverse_kinematics
from trajopt.robot.legs import require_free_flyer
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terrain.crossing import Crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface, frame_of_normal
from trajopt.terrain.swing_paths import (
    crossing_of,
    kept_outside,
    require_clearance,
    smooth_step,
    swing_profile,
)
from trajopt.terrain.terrain import Terrain

# Height of a swing above the straight line between its footholds, over the robot's length.
CLEARANCE_PART = 0.1

# If inverse kinematics moves a joint further than this from the reference, rad, it may have changed branch or
# wound around; the feet then move to their targets in this many steps.
FAR, STEPS = 1.5, 12

# Maps a swinging contact's name, lift-off and touchdown positions and fraction of the swing to its position
# (3,) in m, world.
SwingTrajectory = Callable[[str, np.ndarray, np.ndarray, float], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class FootStance:
    """A contact stays at ``place`` (world, m) from ``begin`` to ``end``, s."""

    begin: float
    end: float
    place: pin.SE3


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class LeggedPosture:
    """Postures of a legged motion over time; see `legged_guess`."""

    robot: Robot
    schedule: Schedule
    base: WaypointPath
    start: np.ndarray
    terrain: Terrain = field(default_factory=FlatGround)
    clearance: float = 0.0
    tuck: float = 0.0
    swing: SwingTrajectory | None = None

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at time ``t`` in s."""
        placement = self.base(t)
        q = self.robot.reference.copy()
        q[:7] = pin.SE3ToXYZQUAT(placement)
        feet = {contact.name: self.foot(contact.name, t, placement) for contact in self.robot.contacts}
        return self._legs(q, feet) if feet else q

    def _legs(self, q: np.ndarray, feet: Mapping[str, pin.SE3]) -> np.ndarray:
        """Move the contacts to ``feet`` on the branch of inverse kinematics that holds the reference.

        This takes one step from the reference posture. If it moves a joint far, the feet move in small steps
        instead, in the base's axes, from their reference positions.
        """
        joints = slice(self.robot.nq - self.robot.nu, None)
        direct = inverse_kinematics(self.robot, q, contact_targets(self.robot, feet)).q
        if np.abs(direct[joints] - q[joints]).max() < FAR:
            return direct
        placement = pin.XYZQUATToSE3(q[:7])
        reference = pin.XYZQUATToSE3(self.robot.reference[:7])
        for part in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
            stepped = {}
            for name, foot in feet.items():
                first, last = reference.actInv(self._reference_feet[name]), placement.actInv(foot)
                stepped[name] = placement * _blend(first, last, part)
            q = inverse_kinematics(self.robot, q, contact_targets(self.robot, stepped)).q
        return q

    def foot(self, name: str, t: float, placement: pin.SE3) -> pin.SE3:
        """Return the world pose of a contact at ``t`` with the base at ``placement``."""
        stances, t = self.stances[name], min(max(t, 0.0), self.schedule.duration)
        for stance in stances:
            if stance.begin - self._rounding <= t <= stance.end + self._rounding:
                return stance.place
        before = next((stance for stance in reversed(stances) if stance.end < t), None)
        after = next((stance for stance in stances if stance.begin > t), None)
        lifted = self._in_the_air_at_first[name] if before is None else before.place
        begin = 0.0 if before is None else before.end
        if after is None:  # it does not land again: it moves with the base as at lift-off
            return placement * self.base(begin).inverse() * lifted
        s = min(max((t - begin) / (after.begin - begin), 0.0), 1.0)
        shared = (min(after.begin, last) - max(begin, first) for first, last in self._flights)
        if any(overlap > self._rounding for overlap in shared):  # the robot flies during the swing
            carried = self._carried(placement, (begin, after.begin), (lifted, after.place), s)
            ends = lifted.translation, after.place.translation
            ground = self._crossing(name, tuple(map(float, ends[0])), tuple(map(float, ends[1])))
            return pin.SE3(
                carried.rotation, kept_outside(ground, carried.translation, s, ends, self.clearance)
            )
        start, end, part = lifted.translation, after.place.translation, smooth_step(s)
        if self.swing is not None:
            position = np.asarray(self.swing(name, start, end, s), dtype=float)
        else:
            position = start + part * (end - start)
            position = position + np.array([0.0, 0.0, self.clearance * swing_profile(s)])
        return pin.SE3(_between(lifted.rotation, after.place.rotation, part), position)

    def _carried(
        self, placement: pin.SE3, times: tuple[float, float], places: tuple[pin.SE3, pin.SE3], s: float
    ) -> pin.SE3:
        """Interpolate between two stances in the base's axes, drawn up and above the line between them.

        The height above that line is the root sum square of the carried height and a swing's height.
        """
        before, after = (self.base(t).actInv(place) for t, place in zip(times, places, strict=True))
        part = smooth_step(s)
        local = _blend(before, after, part)
        drawn_up = np.array([0.0, 0.0, self.tuck * swing_profile(s)])
        position = placement.act(local.translation + drawn_up)
        line = (1 - part) * places[0].translation[2] + part * places[1].translation[2]
        position[2] = line + math.hypot(position[2] - line, self.clearance * swing_profile(s))
        return pin.SE3(placement.rotation @ local.rotation, position)

    @cached_property
    def _crossing(self) -> Callable[[str, tuple[float, ...], tuple[float, ...]], Crossing]:
        """Return the ground between two places of a contact's centre, with edges at the clearance."""

        @cache
        def between(name: str, start: tuple[float, ...], end: tuple[float, ...]) -> Crossing:
            ends, radius = (np.array(start), np.array(end)), self.robot.contact(name).radius
            ground = crossing_of(self.terrain, *ends)
            rise, fall = (
                edge and edge.kept_from(point[None], self.clearance, radius)
                for edge, point in zip((ground.rise, ground.fall), ends, strict=True)
            )
            return replace(ground.offset(radius, *ends), rise=rise, fall=fall)

        return between

    @cached_property
    def _rounding(self) -> float:
        """Tolerance within which times are equal, s."""
        return SAME_TIME * self.schedule.duration

    @cached_property
    def _flights(self) -> list[tuple[float, float]]:
        return flights(self.schedule)

    @cached_property
    def _in_the_air_at_first(self) -> dict[str, pin.SE3]:
        return contact_poses(self.robot, self.start)

    @cached_property
    def stances(self) -> dict[str, list[FootStance]]:
        """Stances of every contact in time order: first at its start position, then where it lands."""
        ends = np.cumsum([phase.duration for phase in self.schedule.phases])
        by_contact: dict[str, list[FootStance]] = {contact.name: [] for contact in self.robot.contacts}
        for name, stances in by_contact.items():
            for i, phase in enumerate(self.schedule.phases):
                if name not in phase.contacts or (i and self.schedule.beginning(name, i) != i):
                    continue
                last = i
                while last + 1 < len(ends) and name in self.schedule.phases[last + 1].contacts:
                    last += 1
                begin, end = float(ends[i] - phase.duration), float(ends[last])
                place = self._in_the_air_at_first[name]
                if i:
                    place = self._landing(name, phase, (begin + end) / 2)
                stances.append(FootStance(begin=begin, end=end, place=place))
        return by_contact

    def _landing(self, name: str, phase: Phase, middle: float) -> pin.SE3:
        """Return the landing pose: the foothold, or the nominal position under the base at mid-stance."""
        nominal, contact = self._nominal(name, self.base(middle)), self.robot.contact(name)
        surface = phase.surface(name, self.terrain, contact.radius).plane_at(nominal.translation)
        centre, patch = phase.centre(contact, self.terrain), phase.patches.get(name)
        position = dropped_onto(nominal.translation, surface) if centre is None else centre
        position = position if patch is None else patch.offset(contact.radius).nearest(position)
        leaning = np.eye(3) if surface.is_level else frame_of_normal(surface.normal)
        return pin.SE3(leaning @ nominal.rotation, np.array(position))

    def _nominal(self, name: str, placement: pin.SE3) -> pin.SE3:
        """Return the contact's pose under an upright base at ``placement``, as in the reference posture."""
        reference = pin.XYZQUATToSE3(self.robot.reference[:7])
        turn = turn_to_heading(placement.rotation) @ turn_to_heading(reference.rotation).T
        foot = self._reference_feet[name]
        position = placement.translation + turn @ (foot.translation - reference.translation)
        return pin.SE3(turn @ foot.rotation, position)

    @cached_property
    def _reference_feet(self) -> dict[str, pin.SE3]:
        return contact_poses(self.robot, self.robot.reference)


@checked
def legged_guess(
    robot: Robot,
    schedule: Schedule,
    path: Sequence[BaseWaypoint] | WaypointPath,
    *,
    start: np.ndarray | None = None,
    terrain: Terrain | None = None,
    clearance: float | None = None,
    tuck: float = 0.0,
    swing: SwingTrajectory | None = None,
) -> Motion:
    """Return a guess ``t -> q`` (nq,) of a legged motion: base on ``path``, feet as the schedule says.

    A landing contact goes to its foothold; without one, to the nominal position under the base at mid-stance,
    on its surface or patch. While other contacts stand, it swings in a smooth arc. If the robot flies, it
    moves with the base, at least as high as that arc and clear of the terrain's edges. Inverse kinematics
    always start from the reference posture, so the guess is a function of time alone.

    Args:
        robot: A robot on a free-flyer in world axes.
        schedule: Phases, contacts and footholds.
        path: Waypoints of the base (see `WaypointPath`).
        start: Configuration (nq,) with the contacts at their first stances; default: the reference.
        terrain: Ground for contacts without a surface of their own; default: level.
        clearance: Height of the swing arc, m; default: a tenth of the robot's length.
        tuck: Height by which feet are drawn up along the base's z axis in mid-flight, m.
        swing: Path of a swinging contact that replaces the arc.

    Raises:
        InputError: If the base is not a free-flyer in world axes, or a length is not finite.
    """
    require_free_flyer(robot)
    lift = CLEARANCE_PART * robot.length if clearance is None else clearance
    require_clearance(lift)
    require_finite("tuck", tuck, "m")
    if not isinstance(path, WaypointPath):
        path = WaypointPath(schedule, path, gravity_of(robot.model))
    posture = LeggedPosture(
        robot=robot,
        schedule=schedule,
        base=path,
        start=np.array(robot.reference if start is None else start, dtype=float),
        terrain=terrain or FlatGround(),
        clearance=lift,
        tuck=tuck,
        swing=swing,
    )
    return RememberedMotion(posture)


def _between(start: np.ndarray, end: np.ndarray, part: float) -> np.ndarray:
    between: np.ndarray = start @ pin.exp3(part * pin.log3(start.T @ end))
    return between


def _blend(start: pin.SE3, end: pin.SE3, part: float) -> pin.SE3:
    """Interpolate poses along a straight line and the shortest rotation."""
    position = (1 - part) * start.translation + part * end.translation
    return pin.SE3(_between(start.rotation, end.rotation, part), position)


def dropped_onto(position: np.ndarray, surface: Surface) -> np.ndarray:
    """Project a point (3,) vertically onto a surface; onto a vertical surface, along its normal."""
    distance, upward = float(surface.distance(position)), float(surface.normal[2])
    if abs(upward) < 1e-6:
        return np.asarray(position - distance * surface.normal)
    return np.asarray(position - np.array([0.0, 0.0, distance / upward]))
