"""A guess for any schedule: base along a smooth path, parabolas in flight, limbs by inverse kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from trajopt.dynamics.base_joint import BASE_POSITION
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.guesses.foot_motion import FootMotion
from trajopt.reduced.footsteps import Foothold, FootstepPlan, StepPhase, landing_place
from trajopt.robot.kinematics import contact_poses, contact_positions, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Schedule
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_profile import smooth_step

# Height of swings in the guess over the robot's length, more than required.
SWING = 0.15
_Target: TypeAlias = pin.SE3 | np.ndarray


def end_posture(
    robot: Robot,
    schedule: Schedule,
    ground: FlatGround,
    start: np.ndarray,
    targets: Mapping[str, _Target],
) -> np.ndarray:
    """Posture at the end (nq,): goals reached, contacts of the last phase on their footholds.

    Goals out of reach are approached in the least-squares sense.
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


def _target(robot: Robot, name: str, place: np.ndarray, start: np.ndarray) -> _Target:
    """A point's position, or a sole's pose with the orientation at the start."""
    if robot.contact(name).kind == "point":
        return place
    return pin.SE3(contact_poses(robot, start)[name].rotation, place)


def _places(
    robot: Robot, schedule: Schedule, ground: FlatGround, start: np.ndarray, end: np.ndarray
) -> list[dict[str, np.ndarray]]:
    """Where each contact is, at the start and after every phase: held, on its foothold, or swinging.

    A contact that lands without a foothold lands on its surface below its position on the way to the end.
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
            now[name] = landing_place(phase, robot.contact(name), ground, way)
        found.append(now)
    return found


class SceneGuess:
    """The motion t -> q (nq,) from ``start`` to ``end`` through a schedule."""

    def __init__(
        self, robot: Robot, schedule: Schedule, ground: FlatGround, start: np.ndarray, end: np.ndarray
    ) -> None:
        self.robot, self.schedule, self.start, self.end = robot, schedule, start, end
        first, *places = _places(robot, schedule, ground, start, end)
        supports = tuple(
            StepPhase(phase.name, phase.duration, {name: Foothold(place[name]) for name in phase.contacts})
            for phase, place in zip(schedule.phases, places, strict=True)
        )
        self.feet = FootMotion(
            plan=FootstepPlan(supports),
            initial={name: Foothold(place) for name, place in first.items()},
            clearance=SWING * robot.length,
        )

    def __call__(self, t: float) -> np.ndarray:
        """Configuration at time ``t`` in s."""
        robot = self.robot
        q = pin.interpolate(robot.model, self.start, self.end, smooth_step(t / self.feet.plan.duration))
        phase, hop = self.schedule.phases[self.feet.support_at(t)], np.array([0.0, 0.0, self._hop(t)])
        n = BASE_POSITION[robot.base]
        if n:
            q[:n] += hop if n == 3 else hop[[0, 2]]
        targets = {
            contact.frame: _target(
                robot, contact.name, self.feet.foothold(contact.name, t).position + hop, self.start
            )
            for contact in robot.contacts
            if n or contact.name in phase.contacts
        }
        return inverse_kinematics(robot, q, targets).q if targets else q

    def _hop(self, t: float) -> float:
        """Height of the parabola of a phase without contacts, m."""
        i = self.feet.support_at(t)
        if self.schedule.phases[i].contacts or self.robot.base == "fixed":
            return 0.0
        s, duration = t - self.feet.times[i], self.schedule.phases[i].duration
        return max(0.0, gravity_of(self.robot.model) * s * (duration - s) / 2)
