"""Full turns of quadrupeds in the air, from feet to feet: a backflip and a barrel roll.

Both leave the ground in two steps: one pair of feet lifts first, so that the body
turns about the other; it lands on the pair that lifted first.
"""

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np
import pinocchio as pin

from trajopt.dynamics import gravity_of
from trajopt.problem import Family, Problem
from trajopt.reduced import BaseWaypoint, legged_guess
from trajopt.robot import Robot, Units, contact_positions, quadruped_legs
from trajopt.schedule import Moment, Schedule, footholds_at, middle_of
from trajopt.terms import FrameDirection, Term

from . import common, leaping, pushing

ROBOTS = ("solo12", "go2", "a1", "hyq")
# Robots for the backflip, which takes hyq to its torque limits throughout (docs/problems/jumps.md).
BACKFLIP_ROBOTS = ("solo12", "go2", "a1")
# Default durations of the phases in units of sqrt(l / g).
DURATIONS = {"stance": 2.0, "tip": 1.0, "flight": 3.0, "catch": 1.0, "landing": 3.0}
PHASES = tuple(DURATIONS)
INTERVALS = 70
# The flight is at most that at this multiple of the largest take-off speed of the legs alone (see
# `pushing.takeoff`), to which the turn about two feet adds.
SPEED_PART = 1.1
# Rotation of the body at take-off in the guess, and remaining rotation at touchdown, rad.
TILT = math.pi / 4
# Height by which legs are drawn up in the guess, over the robot's length.
TUCK = 0.3
# Largest angle to upside down in mid-flight, and to lying on a side a quarter of the flight before and after.
WITHIN = math.pi / 3

Kind = Literal["backflip", "barrel-roll"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Flip:
    """A turn about ``axis`` (3,): feet ``last`` leave the ground last, ``first`` land first."""

    robot: Robot
    axis: np.ndarray
    last: tuple[str, ...]
    first: tuple[str, ...]
    durations: dict[str, float]

    @cached_property
    def _feet(self) -> dict[str, np.ndarray]:
        return contact_positions(self.robot, self.robot.reference)

    def _middle(self, feet: tuple[str, ...]) -> np.ndarray:
        return np.asarray(np.mean([self._feet[name] for name in feet], axis=0))

    @property
    def way(self) -> np.ndarray:
        """Displacement (3,) m: the first feet land where the last ones stood; so the flight is vertical."""
        way: np.ndarray = self._middle(self.last) - self._middle(self.first)
        return way * [1, 1, 0]

    def schedule(self, end: np.ndarray) -> Schedule:
        """On all feet, on the last, in flight, on the first, on all; landing at their ``end`` (nq,)."""
        every = tuple(contact.name for contact in self.robot.contacts)
        contacts = (every, self.last, (), self.first, every)
        return common.schedule_of(self.durations, contacts, footholds_at(self.robot, end))

    def waypoints(self) -> tuple[BaseWaypoint, ...]:
        """Rest, crouch, slightly tipped, take-off, and the same in reverse on the other side."""
        start, sink = self.robot.reference[:3], pushing.SINK_PART * self.robot.length / 2
        stance, landing = self.durations["stance"], self.durations["landing"]
        reach = pushing.EXTENSION_PART * pushing.extension_left(self.robot)
        little = math.asin(min(reach / float(np.linalg.norm(self.way)), math.sin(TILT / 2)))
        ends = np.cumsum([*self.durations.values()])
        low, first = np.array([0.0, 0.0, sink]), pin.log3(pin.Quaternion(self.robot.reference[3:7]).matrix())
        poses = [
            (0.0, start, 0.0),
            (stance / 2, start - low, 0.0),
            (ends[0], self._tipped(little), little),
            (ends[1], self._tipped(TILT), TILT - little),
            (ends[2], self._tipped(-TILT), 2 * math.pi - 2 * TILT),
            (ends[3], self._tipped(-little), TILT - little),
            (ends[3] + landing / 2, start + self.way - low, little),
            (ends[4], start + self.way, 0.0),
        ]
        return tuple(
            BaseWaypoint(time=float(time), position=position, turn=turn * self.axis if i else first)
            for i, (time, position, turn) in enumerate(poses)
        )

    def _tipped(self, angle: float) -> np.ndarray:
        """Return the base (3,) of the standing robot turned about the last feet, or back about the first."""
        start = self.robot.reference[:3]
        pivot = self._middle(self.last if angle > 0 else self.first)
        moved = np.zeros(3) if angle > 0 else self.way
        turned: np.ndarray = pivot + pin.exp3(angle * self.axis) @ (start - pivot) + moved
        return turned

    def turning(self) -> tuple[Term, ...]:
        """In the flight one side of the body is up, halfway its back is down, then the other side is up."""
        up, base = np.array([0.0, 0.0, 1.0]), self.robot.model.names[1]
        side = np.cross(up, self.axis)
        about = partial(FrameDirection, frame=base, direction=tuple(up), angle=WITHIN)
        return (
            about(axis=tuple(side), at=Moment("flight", 0.25)),
            about(axis=tuple(-up), at=middle_of("flight")),
            about(axis=tuple(-side), at=Moment("flight", 0.75)),
        )


def _flip(robot: Robot, kind: Kind, durations: dict[str, float]) -> Flip:
    legs = quadruped_legs(robot)
    hind, front = (legs.hind_left, legs.hind_right), (legs.front_left, legs.front_right)
    left, right = (legs.front_left, legs.hind_left), (legs.front_right, legs.hind_right)
    back = kind == "backflip"
    return Flip(
        robot=robot,
        axis=np.array([0.0, -1.0, 0.0] if back else [1.0, 0.0, 0.0]),
        last=hind if back else right,
        first=front if back else left,
        durations=durations,
    )


def build(
    *, robot: str, friction: float, torque_limit: float | None, kind: Kind, **given: float | None
) -> Problem:
    """Build the flip; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = common.quadruped(robot)
    unit = Units(body).time
    defaults = {name: part * unit for name, part in DURATIONS.items()}
    fastest = SPEED_PART * pushing.takeoff(body, torque_limit).speed
    defaults["flight"] = min(defaults["flight"], 2 * fastest / gravity_of(body.model))
    durations = common.filled(defaults, given)
    flip = _flip(body, kind, durations)
    end = common.displaced(body, flip.way)
    schedule = flip.schedule(end)
    lift = leaping.CLEARANCE_PART * body.length
    return common.problem(
        f"quadruped-{kind}",
        body,
        schedule,
        legged_guess(body, schedule, flip.waypoints(), clearance=lift, tuck=TUCK * body.length),
        costs=leaping.COSTS,
        torque_limit=torque_limit,
        friction=friction,
        clearance=lift,
        more=(*leaping.above_ground(body, dict.fromkeys(PHASES, 0.0)), *flip.turning()),
        end=end,
        parameters=durations,
        default_intervals=INTERVALS,
    )


def _family(kind: Kind, summary: str) -> Family:
    return Family(
        name=f"quadruped-{kind}",
        robots=BACKFLIP_ROBOTS if kind == "backflip" else ROBOTS,
        phases=PHASES,
        summary=summary,
        parameters=(
            common.duration("stance", None, "duration of the push on all feet", (1e-3, 10.0)),
            common.duration("tip", None, "duration of the push on two feet", (1e-3, 10.0)),
            common.duration("flight", None, "duration of the flight", (1e-3, 3.0)),
            common.duration("catch", None, "duration of the landing on two feet", (1e-3, 10.0)),
            common.duration("landing", None, "duration on all feet, to rest", (1e-3, 10.0)),
            common.friction(0.7),
            common.TORQUE_LIMIT,
        ),
        build=partial(build, kind=kind),
    )


FAMILIES = (
    _family("backflip", "backward somersault from the hind feet onto the front feet"),
    _family("barrel-roll", "full roll in the air from the right feet onto the left feet"),
)
