"""Guesses of gaits: base at the commanded pace, ballistic in flight, feet under their hips at mid-stance.

Each foothold is where the hip is at mid-stance, so that the leg acts symmetrically ahead and behind (Raibert,
"Legged robots that balance", 1986, ch. 2: the neutral point).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import contact_jacobian, gravity_of
from trajopt.errors import InputError
from trajopt.problem.contact_paths import SAME_TIME
from trajopt.reduced.base_path import (
    BaseWaypoint,
    WaypointPath,
    flights,
    heading_of,
    turn_to_heading,
)
from trajopt.reduced.legged import legged_guess, stances_under
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import UP
from trajopt.terrain.swing_paths import smooth_step

# Step of the finite differences for rates, s; contacts are then brought exactly to rest.
DIFFERENCE_STEP = 1e-4


@checked
@dataclass(frozen=True, kw_only=True)
class Pace:
    """A commanded motion of the base over level ground along an arc, optionally from or to rest.

    Args:
        velocity: Forward and leftward velocity in the base's axes, m/s.
        turn_rate: Rate of turning left, rad/s.
        starts: Times (begin, end) in s between which the pace rises from zero; None: the pace is constant.
        stops: Times (begin, end) in s between which the pace falls to zero; None: the pace is constant.

    Raises:
        InputError: If a number is not finite or times do not increase.
    """

    velocity: tuple[float, float]
    turn_rate: float = 0.0
    starts: tuple[float, float] | None = None
    stops: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for times in (self.starts, self.stops):
            if times is not None and not times[0] < times[1]:
                raise InputError(
                    f"a pace changes from {times[0]:g} to {times[1]:g} s", "allowed: rising times"
                )

    def part(self, t: float) -> float:
        """Return the fraction of the full pace at ``t`` s, 0 to 1."""
        rise = 1.0 if self.starts is None else smooth_step(_fraction(t, self.starts))
        fall = 0.0 if self.stops is None else smooth_step(_fraction(t, self.stops))
        return rise - fall

    def progress(self, t: float) -> float:
        """Return the time in s that the full pace needs for the distance covered from 0 to ``t`` s."""
        return self._travelled(t) - self._travelled(0.0)

    def _travelled(self, t: float) -> float:
        rise = t if self.starts is None else _travelled(t, self.starts)
        return rise - (0.0 if self.stops is None else _travelled(t, self.stops))

    def pose(self, t: float) -> tuple[np.ndarray, float]:
        """Return the displacement (2,) m and turn rad since ``t`` = 0, in the base's axes at that time.

        The path is an arc: p = (sin(a) / w) v + ((1 - cos(a)) / w) z x v, with the turn a = w progress.
        """
        time, forward = self.progress(t), np.array(self.velocity)
        angle = self.turn_rate * time
        half = angle / 2
        along = time * np.sinc(angle / math.pi)
        across = time * np.sinc(half / math.pi) * math.sin(half)
        return along * forward + across * np.array([-forward[1], forward[0]]), angle


def _fraction(t: float, times: tuple[float, float]) -> float:
    return (t - times[0]) / (times[1] - times[0])


def _travelled(t: float, times: tuple[float, float]) -> float:
    """Integrate ``smooth_step(fraction)`` up to ``t``: s^4 (5/2 - 3 s + s^2), then linear."""
    s = min(max(_fraction(t, times), 0.0), 1.0)
    return (times[1] - times[0]) * s**4 * (2.5 - 3 * s + s * s) + max(t - times[1], 0.0)


def base_pose(robot: Robot, pace: Pace, t: float) -> pin.SE3:
    """Return the base at ``t`` s: the reference's pose moved horizontally and turned by the pace."""
    start = pin.XYZQUATToSE3(robot.reference[:7])
    turned = turn_to_heading(start.rotation)
    shift, angle = pace.pose(t)
    position = start.translation + turned @ np.append(shift, 0.0)
    return pin.SE3(np.array(pin.utils.rotate("z", angle)) @ start.rotation, position)


@checked
def commanded_motion(robot: Robot, pace: Pace) -> Motion:
    """Return the reference motion of a gait, ``t -> q`` (nq,): the reference posture moved by the pace."""
    return partial(_carried, robot, pace)


def _carried(robot: Robot, pace: Pace, t: float) -> np.ndarray:
    q = robot.reference.copy()
    q[:7] = pin.SE3ToXYZQUAT(base_pose(robot, pace, t))
    return q


def gait_path(robot: Robot, schedule: Schedule, pace: Pace, *, begin: float = 0.0) -> WaypointPath:
    """Return the base path at a pace for a schedule that starts at time ``begin`` (s) of the pace.

    Waypoints are at every phase boundary. Stances between two flights have them only at their ends, so that
    the base sinks and rises in one smooth bounce. Raises `InputError`.
    """
    waypoints: list[BaseWaypoint] = []
    before = np.eye(3)
    for time in _waypoint_times(schedule):
        placement = base_pose(robot, pace, begin + time)
        velocity, rate = _velocity(robot, pace, begin + time)
        waypoints.append(
            BaseWaypoint(
                time=time,
                position=placement.translation,
                turn=pin.log3(placement.rotation @ before.T),
                velocity=velocity,
                rate=rate,
            )
        )
        before = placement.rotation
    return WaypointPath(schedule, waypoints, gravity_of(robot.model))


def _waypoint_times(schedule: Schedule) -> list[float]:
    """Return all phase boundaries except those within a stance between two flights."""
    ends = np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])
    flown = flights(schedule)
    rounding = SAME_TIME * schedule.duration
    edges = {time for flight in flown for time in flight}

    def counts(t: float) -> bool:
        landed = any(end < t - rounding for _, end in flown)
        leaves = any(begin > t + rounding for begin, _ in flown)
        return any(abs(t - edge) < rounding for edge in edges) or not (landed and leaves)

    return [float(t) for t in ends if counts(t)]


def _velocity(robot: Robot, pace: Pace, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return velocity (3,) m/s and angular velocity (3,) rad/s of the base at ``t`` s, world."""
    part, (_, angle) = pace.part(t), pace.pose(t)
    heading = heading_of(pin.XYZQUATToSE3(robot.reference[:7]).rotation) + angle
    forward = np.array([*pace.velocity, 0.0])
    turned = np.array(pin.utils.rotate("z", heading)) @ forward
    return part * turned, np.array([0.0, 0.0, part * pace.turn_rate])


@dataclass(frozen=True, kw_only=True, eq=False)
class GaitPlan:
    """A schedule with footholds for all landing contacts, and its guess ``t -> q`` (nq,).

    The first phase has footholds for contacts that land at its start, after the preceding cycle.
    """

    schedule: Schedule
    guess: Motion

    def state(self, robot: Robot, t: float, resting: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of the guess at a time, with some contacts exactly at rest.

        Rates are finite differences. Joint rates get the smallest correction that stops the contacts.

        Args:
            robot: The robot.
            t: Time, s.
            resting: Names of the contacts at rest.

        Returns:
            Configuration (nq,) and velocity (nv,).
        """
        q, step = self.guess(t), DIFFERENCE_STEP
        v = pin.difference(robot.model, self.guess(t - step), self.guess(t + step)) / (2 * step)
        places = [(robot.contact(name).frame, robot.contact(name).rows) for name in resting]
        jacobian = contact_jacobian(robot.model, q, places)
        joints = robot.actuated_rows
        v[joints] -= np.linalg.lstsq(jacobian[:, joints], jacobian @ v, rcond=None)[0]
        return q, v


@checked
def plan_of_cycle(
    robot: Robot, cycle: Schedule, pace: Pace, *, mirror: Mapping[str, str] | None = None, clearance: float
) -> GaitPlan:
    """Return the plan of a periodic motion: the middle one of five cycles.

    Args:
        robot: The robot.
        cycle: Contacts over one cycle, or over half of one.
        pace: Commanded motion of the base.
        mirror: If ``cycle`` is half a cycle: the opposite contact of every contact. The preceding and
            following halves are then its mirror images.
        clearance: Height of swings, m.

    Raises:
        InputError: If the clearance is negative or not finite.
    """
    whole, first = _repeated(cycle, mirror)
    return plan_of_part(robot, cycle, whole, first * len(cycle.phases), pace, clearance=clearance)


@checked
def plan_of_part(
    robot: Robot, part: Schedule, whole: Schedule, first: int, pace: Pace, *, clearance: float
) -> GaitPlan:
    """Return the plan of a part of a longer schedule.

    The longer schedule determines the swings in progress at the ends of the part, and the middle of stances
    that extend beyond them.

    Args:
        robot: The robot.
        part: Contacts over time.
        whole: The longer schedule.
        first: Index of the phase of ``whole`` at which the part begins.
        pace: Commanded motion, in time from the start of the part, where the base is at the reference.
        clearance: Height of swings, m.

    Raises:
        InputError: If the clearance is negative or not finite.
    """
    begin = sum(phase.duration for phase in whole.phases[:first])
    path = gait_path(robot, whole, pace, begin=-begin)
    motion = legged_guess(robot, whole, path, clearance=clearance)
    landings = with_footholds(robot, whole, path).phases[first:]
    phases = [
        replace(phase, footholds=landing.footholds)
        for phase, landing in zip(part.phases, landings, strict=False)
    ]
    return GaitPlan(schedule=Schedule(tuple(phases)), guess=partial(_later, motion, begin))


def _later(motion: Motion, begin: float, t: float) -> np.ndarray:
    return motion(t + begin)


def _repeated(cycle: Schedule, mirror: Mapping[str, str] | None) -> tuple[Schedule, int]:
    """Return this cycle or half-cycle with two full cycles before it and two after it, and its index.

    A foot that swings at the start lifted off in the previous cycle. With two of them, the base already moves
    periodically there.
    """
    this = other = cycle.phases
    if mirror is not None:
        other = tuple(replace(p, contacts=tuple(mirror[name] for name in p.contacts)) for p in this)
    first = 2 if mirror is None else 4
    pieces = (this, other) * first + (this,)
    phases = [replace(phase, name=f"{phase.name}_{i}") for i, piece in enumerate(pieces) for phase in piece]
    return Schedule(tuple(phases)), first


def with_footholds(robot: Robot, schedule: Schedule, path: WaypointPath) -> Schedule:
    """Add footholds on level ground wherever contacts begin with a phase, as in `legged_guess`."""
    stances = stances_under(robot, schedule, path, robot.reference, FlatGround())
    begins = np.cumsum([0.0, *(phase.duration for phase in schedule.phases)])
    rounding = SAME_TIME * schedule.duration
    phases = []
    for i, phase in enumerate(schedule.phases):
        places = {
            name: stance.pose.translation - robot.contact(name).radius * np.array(UP)
            for name in schedule.new_contacts(i)
            for stance in stances[name]
            if abs(stance.begin - begins[i]) < rounding
        }
        phases.append(replace(phase, footholds=places))
    return Schedule(tuple(phases))
