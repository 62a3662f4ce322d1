"""A guess for any schedule: base along a smooth path, parabolas in flight, limbs by inverse kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_POSITION
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.robot.kinematics import contact_poses, contact_positions, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_profile import smooth_step

# Swings rise by this part of the robot's length in the guess, more than they must.
SWING = 0.15
Target: TypeAlias = pin.SE3 | np.ndarray


def end_posture(
    robot: Robot,
    schedule: Schedule,
    ground: FlatGround,
    start: np.ndarray,
    targets: Mapping[str, Target],
) -> np.ndarray:
    """Posture at the end (nq,): goals reached, contacts of the last phase on their places.

    What cannot be reached is approached in the least-squares sense.
    """
    places = _places(robot, schedule, ground, start, start)[-1]
    moved = np.mean(
        [places[name] - place for name, place in contact_positions(robot, start).items()] or [np.zeros(3)],
        axis=0,
    )
    q = start.copy()
    n = BASE_POSITION[robot.base]
    if n:
        q[:n] += moved if n == 3 else moved[[0, 2]]
    holds = {
        contact.frame: _target(robot, contact.name, places[contact.name], start)
        for contact in robot.contacts
        if contact.name in schedule.phases[-1].contacts
    }
    wanted = {**holds, **targets}
    if not wanted:
        return q
    return inverse_kinematics(robot, q, wanted, move_base=bool(n)).q


def _target(robot: Robot, name: str, place: np.ndarray, start: np.ndarray) -> Target:
    """A point's place, or a sole's pose turned as at the start."""
    if robot.contact(name).kind == "point":
        return place
    return pin.SE3(contact_poses(robot, start)[name].rotation, place)


def _places(
    robot: Robot, schedule: Schedule, ground: FlatGround, start: np.ndarray, end: np.ndarray
) -> list[dict[str, np.ndarray]]:
    """Where each contact is, at the start and after every phase: held, on its foothold, or on its way.

    A contact that lands without a foothold lands on its surface below where it is on the way to the end.
    """
    first = contact_positions(robot, start)
    last = contact_positions(robot, end)
    times = list(accumulate(phase.duration for phase in schedule.phases))
    found = [dict(first)]
    for index, phase in enumerate(schedule.phases):
        now = dict(found[-1])
        for name in schedule.new_contacts(index):
            share = smooth_step((times[index] - phase.duration) / times[-1])
            way = (1 - share) * first[name] + share * last[name]
            surface = phase.surface(name, ground).plane_at(way)
            now[name] = phase.footholds.get(name, way - surface.distance(way) * surface.normal)
        found.append(now)
    return found


class SceneGuess:
    """The motion t -> q (nq,) from ``start`` to ``end`` through a schedule."""

    def __init__(
        self, robot: Robot, schedule: Schedule, ground: FlatGround, start: np.ndarray, end: np.ndarray
    ) -> None:
        self.robot, self.schedule, self.start, self.end = robot, schedule, start, end
        self.times = [0.0, *accumulate(phase.duration for phase in schedule.phases)]
        self.places = _places(robot, schedule, ground, start, end)

    def __call__(self, t: float) -> np.ndarray:
        """Configuration at time ``t`` in s."""
        robot = self.robot
        q = pin.interpolate(robot.model, self.start, self.end, smooth_step(t / self.times[-1]))
        hop = self._hop(t)
        n = BASE_POSITION[robot.base]
        if n:
            up = np.array([0.0, 0.0, hop])
            q[:n] += up if n == 3 else up[[0, 2]]
        targets = {
            contact.frame: _target(robot, contact.name, self._place(contact.name, t, hop), self.start)
            for contact in robot.contacts
            if n or contact.name in self._phase(t).contacts
        }
        return inverse_kinematics(robot, q, targets).q if targets else q

    def _index(self, t: float) -> int:
        return int(np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2))

    def _phase(self, t: float) -> Phase:
        return self.schedule.phases[self._index(t)]

    def _hop(self, t: float) -> float:
        """Height of the parabola of a phase without contacts, m."""
        i = self._index(t)
        if self._phase(t).contacts or self.robot.base == "fixed":
            return 0.0
        s, duration = t - self.times[i], self.schedule.phases[i].duration
        return max(0.0, gravity_of(self.robot.model) * s * (duration - s) / 2)

    def _place(self, name: str, t: float, hop: float) -> np.ndarray:
        """Where a contact is: held, or from its last place to its next, lifted on the way."""
        phases, now = self.schedule.phases, self._index(t)
        if name in phases[now].contacts:
            return self.places[now + 1][name]
        before = next((i for i in range(now, -1, -1) if name in phases[i].contacts), -1)
        after = next((i for i in range(now, len(phases)) if name in phases[i].contacts), None)
        begin = self.times[before + 1]
        over = self.times[-1] if after is None else self.times[after]
        start = self.places[before + 1][name]
        goal = start if after is None else self.places[after + 1][name]
        s = min(max((t - begin) / (over - begin), 0.0), 1.0)
        lift = np.array([0.0, 0.0, SWING * self.robot.length * 16 * s * s * (1 - s) ** 2 + hop])
        return np.asarray((1 - smooth_step(s)) * start + smooth_step(s) * goal + lift)
