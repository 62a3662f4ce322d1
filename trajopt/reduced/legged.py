"""One guess for all legged motions: base on a path, feet on footholds, legs by inverse kinematics."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.pickling import picklable
from trajopt.problem.contact_paths import (
    SAME_TIME,
    ContactPaths,
    RememberedMotion,
    Stance,
    blended,
    stances_of,
    stepped_posture,
)
from trajopt.reduced.base_path import BaseWaypoint, WaypointPath, flights, turn_to_heading
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses, contact_targets, inverse_kinematics
from trajopt.robot.legs import require_free_flyer
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terrain.crossing import Crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface, frame_of_normal
from trajopt.terrain.swing_paths import (
    SwingPath,
    crossing_of,
    kept_outside,
    smooth_step,
    swing_profile,
)
from trajopt.terrain.terrain import Terrain

# Height of a swing above the straight line between its footholds, over the robot's length.
CLEARANCE_PART = 0.1

# If inverse kinematics moves a joint further than this from the reference, rad, it may have changed branch or
# wound around; the feet then move to their targets in small steps.
FAR = 1.5

# Placement of the base over time, s.
BaseMotion = Callable[[float], pin.SE3]


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class LeggedPosture:
    """Postures of a legged motion over time: base on a path, legs by inverse kinematics.

    Args:
        robot: The robot.
        base: Placement of the base over time.
        contacts: Where contacts are, unless the robot flies while they are in the air.
        flights: Begin and end of every flight, s. In a swing that overlaps one, contacts move with the base.
        terrain: Ground whose edges contacts keep clear of in flight.
        tuck: Height by which feet are drawn up along the base's z axis in mid-flight, m.
    """

    robot: Robot
    base: BaseMotion
    contacts: ContactPaths
    flights: Sequence[tuple[float, float]]
    terrain: Terrain = field(default_factory=FlatGround)
    tuck: float = 0.0

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at time ``t`` in s."""
        placement = self.base(t)
        q = self.robot.reference.copy()
        q[:7] = pin.SE3ToXYZQUAT(placement)
        feet = {contact.name: self.foot(contact.name, t, placement) for contact in self.robot.contacts}
        return self._legs(q, feet) if feet else q

    def _legs(self, q: np.ndarray, feet: Mapping[str, pin.SE3]) -> np.ndarray:
        """Move the contacts to ``feet`` on the branch of inverse kinematics that holds the reference.

        This takes one step from the reference posture, or small ones if that moves a joint far.
        """
        joints = slice(self.robot.nq - self.robot.nu, None)
        direct = inverse_kinematics(self.robot, q, contact_targets(self.robot, feet)).q
        if np.abs(direct[joints] - q[joints]).max() < FAR:
            return direct
        return stepped_posture(self.robot, self.robot.reference, pin.XYZQUATToSE3(q[:7]), feet).q

    def foot(self, name: str, t: float, placement: pin.SE3) -> pin.SE3:
        """Return the world pose of a contact at ``t`` with the base at ``placement``."""
        before, after, s = self.contacts.around(name, t)
        if before is after:
            if t <= before.end * (1 + SAME_TIME):
                return before.pose
            # It does not land again: it moves with the base as at lift-off.
            return placement * self.base(before.end).inverse() * before.pose
        lift_off, touchdown = before.end, after.begin
        shared = (min(touchdown, end) - max(lift_off, begin) for begin, end in self.flights)
        if max(shared, default=0.0) <= SAME_TIME * touchdown:
            return self.contacts.pose(name, t)
        carried = self._carried(placement, (lift_off, touchdown), (before.pose, after.pose), s)
        ends = before.pose.translation, after.pose.translation
        ground = self._crossing(name, tuple(map(float, ends[0])), tuple(map(float, ends[1])))
        clear = kept_outside(ground, carried.translation, s, ends, self.contacts.clearance)
        return pin.SE3(carried.rotation, clear)

    def _carried(
        self, placement: pin.SE3, times: tuple[float, float], places: tuple[pin.SE3, pin.SE3], s: float
    ) -> pin.SE3:
        """Interpolate between two stances in the base's axes, drawn up and above the line between them.

        The height above that line is the root sum square of the carried height and a swing's height.
        """
        before, after = (self.base(t).actInv(place) for t, place in zip(times, places, strict=True))
        part = smooth_step(s)
        local = blended(before, after, part)
        drawn_up = np.array([0.0, 0.0, self.tuck * swing_profile(s)])
        position = placement.act(local.translation + drawn_up)
        line = (1 - part) * places[0].translation[2] + part * places[1].translation[2]
        position[2] = line + math.hypot(position[2] - line, self.contacts.clearance * swing_profile(s))
        return pin.SE3(placement.rotation @ local.rotation, position)

    @cached_property
    def _crossing(self) -> Callable[[str, tuple[float, ...], tuple[float, ...]], Crossing]:
        """Return the ground between two places of a contact's centre, with edges at the clearance."""

        @cache
        def between(name: str, start: tuple[float, ...], end: tuple[float, ...]) -> Crossing:
            ends, radius = (np.array(start), np.array(end)), self.robot.contact(name).radius
            ground = crossing_of(self.terrain, *ends)
            rise, fall = (
                edge and edge.kept_from(point[None], self.contacts.clearance, radius)
                for edge, point in zip((ground.rise, ground.fall), ends, strict=True)
            )
            return replace(ground.offset(radius, *ends), rise=rise, fall=fall)

        return between


def stances_under(
    robot: Robot, schedule: Schedule, base: BaseMotion, start: np.ndarray, terrain: Terrain
) -> dict[str, tuple[Stance, ...]]:
    """Return the stances of every contact: first where it is at ``start`` (nq,), then where it lands.

    It lands on its foothold; without one, on its surface or patch, at the nominal position under the base in
    the middle of the stance.
    """
    first = contact_poses(robot, start)

    def stances(contact: Contact) -> Iterator[Stance]:
        def landing(index: int, begin: float, end: float) -> pin.SE3:
            nominal = _nominal(robot, contact.name, base((begin + end) / 2))
            return _landing(schedule.phases[index], contact, terrain, nominal)

        return stances_of(schedule, contact.name, first[contact.name], landing)

    return {contact.name: tuple(stances(contact)) for contact in robot.contacts}


def _landing(phase: Phase, contact: Contact, terrain: Terrain, nominal: pin.SE3) -> pin.SE3:
    """Pose of a contact that lands near its ``nominal`` pose."""
    surface = phase.surface(contact.name, terrain, contact.radius).plane_at(nominal.translation)
    centre, patch = phase.centre(contact, terrain), phase.patches.get(contact.name)
    position = dropped_onto(nominal.translation, surface) if centre is None else centre
    position = position if patch is None else patch.offset(contact.radius).nearest(position)
    leaning = np.eye(3) if surface.is_level else frame_of_normal(surface.normal)
    return pin.SE3(leaning @ nominal.rotation, np.array(position))


def _nominal(robot: Robot, name: str, placement: pin.SE3) -> pin.SE3:
    """Pose of a contact under an upright base at ``placement``, as in the reference posture."""
    reference, foot = pin.XYZQUATToSE3(robot.reference[:7]), contact_poses(robot, robot.reference)[name]
    turn = turn_to_heading(placement.rotation) @ turn_to_heading(reference.rotation).T
    position = placement.translation + turn @ (foot.translation - reference.translation)
    return pin.SE3(turn @ foot.rotation, position)


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
    swing: SwingPath | None = None,
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
    if not isinstance(path, WaypointPath):
        path = WaypointPath(schedule, path, gravity_of(robot.model))
    ground, first = terrain or FlatGround(), robot.reference if start is None else start
    stances = stances_under(robot, schedule, path, first, ground)
    return RememberedMotion(
        LeggedPosture(
            robot=robot,
            base=path,
            contacts=ContactPaths(stances=stances, clearance=lift, swing=swing),
            flights=flights(schedule),
            terrain=ground,
            tuck=tuck,
        )
    )


def dropped_onto(position: np.ndarray, surface: Surface) -> np.ndarray:
    """Project a point (3,) vertically onto a surface; onto a vertical surface, along its normal."""
    distance, upward = float(surface.distance(position)), float(surface.normal[2])
    if abs(upward) < 1e-6:
        return np.asarray(position - distance * surface.normal)
    return np.asarray(position - np.array([0.0, 0.0, distance / upward]))
