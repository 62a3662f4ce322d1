"""Footsteps: footholds and their timing, the plan of a walk, and its schedule."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated

import numpy as np
import pinocchio as pin

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape, Range
from trajopt.problem.contact_paths import ContactPaths, Stance, stances_of
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terrain.surface import UP


@checked
@dataclass(frozen=True, eq=False)
class Foothold:
    """A foot on level ground: ``position`` (3,) of the contact frame, world, m; ``yaw`` in rad."""

    position: Annotated[np.ndarray, ArrayShape((3,))]
    yaw: float = 0.0

    @property
    def pose(self) -> pin.SE3:
        """Level pose of the contact frame, world, m."""
        return pin.SE3(pin.utils.rotate("z", self.yaw), self.position)


@checked
@dataclass(frozen=True)
class StepPhase:
    """A period, s, with constant feet on the ground, by contact name; no feet in flight."""

    name: str
    duration: Positive
    feet: Mapping[str, Foothold] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "feet", MappingProxyType(dict(self.feet)))


@checked
@dataclass(frozen=True)
class FootstepPlan:
    """Supports in time order; a foot in two consecutive supports does not move."""

    supports: tuple[StepPhase, ...]

    def __post_init__(self) -> None:
        if not self.supports:
            raise InputError("the footstep plan has no support", "allowed: at least one")
        for before, after in pairwise(self.supports):
            for name in before.feet.keys() & after.feet.keys():
                moved = np.abs(before.feet[name].position - after.feet[name].position).max()
                if moved > 0 or before.feet[name].yaw != after.feet[name].yaw:
                    raise InputError(
                        f"foot '{name}' moves from '{before.name}' to '{after.name}' without being lifted",
                        "allowed: a foot of both supports at one place",
                    )

    @property
    def duration(self) -> float:
        """Duration of the plan in s."""
        return sum(support.duration for support in self.supports)

    def schedule(self, robot: Robot | None = None) -> Schedule:
        """Return phases with the supports' names and durations; new contacts land on their footholds.

        ``robot`` gives the radii of the contacts: footholds are on the ground, a radius below their frames.
        """
        phases, before = [], self.supports[0].feet
        for support in self.supports:
            new = {
                name: foot.position - (robot.contact(name).radius if robot else 0.0) * np.array(UP)
                for name, foot in support.feet.items()
                if name not in before
            }
            phases.append(
                Phase(
                    name=support.name, duration=support.duration, contacts=tuple(support.feet), footholds=new
                )
            )
            before = support.feet
        return Schedule(tuple(phases))

    def contact_paths(self, start: Mapping[str, Foothold], clearance: float) -> ContactPaths:
        """Return the feet over time, with swings of height ``clearance`` m.

        Before its first support a foot is where ``start`` has it, by contact name. Raises InputError for a
        clearance that is negative or not finite.
        """
        schedule, first = self.schedule(), {**start, **self.supports[0].feet}

        def stances(name: str) -> Iterator[Stance]:
            def landing(index: int, begin: float, end: float) -> pin.SE3:
                return self.supports[index].feet[name].pose

            return stances_of(schedule, name, first[name].pose, landing)

        return ContactPaths(stances={name: tuple(stances(name)) for name in first}, clearance=clearance)


def support_vertices(robot: Robot, support: StepPhase, shrink: float = 0.0) -> np.ndarray:
    """Return points (n, 2) in m whose convex hull is the support polygon: contact points, corners of soles.

    ``shrink`` in [0, 1) is the fraction of a sole's size kept as a margin. Raises InputError in flight.
    """
    if not support.feet:
        raise InputError(f"support '{support.name}' has no foot", "allowed: at least one, to hold the ZMP")
    points = []
    for name, foot in support.feet.items():
        contact = robot.contact(name)
        length, width = (1 - shrink) * contact.half_length, (1 - shrink) * contact.half_width
        corners = [(0.0, 0.0)]
        if contact.kind == "surface":
            corners = [(length, width), (-length, width), (-length, -width), (length, -width)]
        turn = np.array([[math.cos(foot.yaw), -math.sin(foot.yaw)], [math.sin(foot.yaw), math.cos(foot.yaw)]])
        points += [foot.position[:2] + turn @ np.array(corner) for corner in corners]
    return np.array(points)


def feet_of(robot: Robot, q: np.ndarray) -> dict[str, Foothold]:
    """Return the footholds of a robot's contacts at ``q`` (nq,), by contact name."""
    feet, poses = {}, contact_poses(robot, q)
    for contact in robot.contacts:
        placement = poses[contact.name]
        yaw = math.atan2(placement.rotation[1, 0], placement.rotation[0, 0])
        feet[contact.name] = Foothold(
            position=placement.translation, yaw=yaw if contact.kind == "surface" else 0.0
        )
    return feet


@checked
@dataclass(frozen=True, kw_only=True)
class Walk:
    """A walk of a biped that starts and ends at rest with its feet side by side.

    Args:
        steps: Number of steps, at least two. The last one brings the feet side by side, so the walk advances
            by ``(steps - 1) * length``.
        length: Distance between steps along the path, m; negative walks backwards.
        side: Mean distance to the left per step, m; negative walks to the right. The foot on that side steps
            sideways by twice this distance and the other one follows.
        width: Distance between the feet across the path, m; None keeps the initial one.
        turn: Turn to the left per step, rad.
        step_time: Duration of single support, s.
        double_support: Duration of double support between steps, s.
        shift_time: Duration of the double support before the first step, s.
        settle_time: Duration of the double support after the last step, s.
        first: Contact that steps first; default: the robot's first.

    Raises:
        InputError: If a number is out of range.
    """

    steps: Annotated[int, Range(2)] = 2
    length: float = 0.15
    side: float = 0.0
    width: Positive | None = None
    turn: float = 0.0
    step_time: Positive = 0.6
    double_support: Positive = 0.15
    shift_time: Positive = 0.5
    settle_time: Positive = 0.6
    first: str | None = None

    def plan(self, robot: Robot, q: np.ndarray | None = None) -> FootstepPlan:
        """Return the supports of this walk from the feet at ``q`` (nq,), by default the robot's reference.

        Supports are named shift, step_1, double_1, step_2, ..., settle. Raises InputError if the robot is not
        a biped or the first foot is unknown.
        """
        start = feet_of(robot, robot.reference if q is None else q)
        if len(start) != 2:
            raise InputError(
                f"robot '{robot.name}' has {len(start)} contacts", "allowed: a biped, 2 contacts"
            )
        swing = robot.contacts[0].name if self.first is None else robot.contact(self.first).name
        supports, feet = [StepPhase(name="shift", duration=self.shift_time, feet=start)], start
        path = _FootPath(start, self.width)
        for step in range(1, self.steps + 1):
            stance = next(name for name in feet if name != swing)
            held = {stance: feet[stance]}
            supports.append(StepPhase(name=f"step_{step}", duration=self.step_time, feet=held))
            if step < self.steps:
                path.advance(self.length, self.turn)
                path.aside(swing, self.side)
            feet = {name: path.foothold(name) if name == swing else feet[name] for name in start}
            last = step == self.steps
            name, duration = ("settle", self.settle_time) if last else (f"double_{step}", self.double_support)
            supports.append(StepPhase(name=name, duration=duration, feet=feet))
            swing = stance
        return FootstepPlan(tuple(supports))


class _FootPath:
    """A path on the ground that starts between the feet; each foot stays on its own side."""

    def __init__(self, feet: Mapping[str, Foothold], width: float | None) -> None:
        points = {name: foot.position for name, foot in feet.items()}
        first, second = points.values()
        self.middle, across = (first + second) / 2, first - second
        # Forward is perpendicular to the line between the feet, on the side to which they point.
        heading = math.atan2(-across[0], across[1])
        mean = np.mean([foot.yaw for foot in feet.values()])
        self.heading = heading + math.pi * (math.cos(heading - mean) < 0)
        self.yaws = {name: foot.yaw - self.heading for name, foot in feet.items()}
        half = (np.linalg.norm(across[:2]) if width is None else width) / 2
        left = self._left()
        self.offsets = {
            name: half * math.copysign(1.0, float(left @ (point - self.middle)[:2]))
            for name, point in points.items()
        }

    def _left(self) -> np.ndarray:
        return np.array([-math.sin(self.heading), math.cos(self.heading)])

    def advance(self, length: float, turn: float) -> None:
        """Move along the chord of the turn's arc and turn by ``turn`` rad."""
        self.heading += turn / 2
        self.middle = self.middle + length * np.array([math.cos(self.heading), math.sin(self.heading), 0.0])
        self.heading += turn / 2

    def aside(self, name: str, way: float) -> None:
        """Move left by twice ``way``, but only as the foot on that side steps, so that feet do not cross."""
        if way * self.offsets[name] > 0:
            self.middle = self.middle + 2 * way * np.append(self._left(), 0.0)

    def foothold(self, name: str) -> Foothold:
        position = self.middle.copy()
        position[:2] += self.offsets[name] * self._left()
        return Foothold(position=position, yaw=self.heading + self.yaws[name])
