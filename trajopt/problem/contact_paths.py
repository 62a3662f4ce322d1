"""Feet and hands over time: at rest where they stand, in the air in between."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, groupby

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, checked
from trajopt.robot.kinematics import Posture, contact_poses, contact_targets, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terrain.swing_paths import SwingPath, smooth_step, swing_profile

# Times that differ by less than this fraction of the schedule's duration are equal.
SAME_TIME = 1e-9
# Cached configurations: a guess is evaluated three times at every point.
CACHED_POSTURES = 4096
# Steps of inverse kinematics from one posture to another, so that joints stay on their branch.
STEPS = 12


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """A contact's frame stays at a pose.

    Args:
        begin: Start of the stance, s.
        end: End of the stance, s.
        pose: Of the frame, world, m.
    """

    begin: float
    end: float
    pose: pin.SE3


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class ContactPaths:
    """Poses of contacts over time: at rest in a stance, then in a smooth swing to the next one.

    Before its first stance and after its last one, a contact is where that has it.

    Args:
        stances: Stances of each contact in time order, at least one, by the contact's name.
        clearance: Height of the arc of a swing above the straight line between its ends, m.
        swing: Path of a swinging contact that replaces the arc.

    Raises:
        InputError: If the clearance is negative or not finite.
    """

    stances: Mapping[str, Sequence[Stance]]
    clearance: NonNegative
    swing: SwingPath | None = None

    def around(self, name: str, t: float) -> tuple[Stance, Stance, float]:
        """Return the stances before and after ``t`` s, and the fraction of the swing between them.

        Both are the same if the contact stands, or does not land again.
        """
        stances = self.stances[name]
        rounding = SAME_TIME * stances[-1].end
        before = next((stance for stance in reversed(stances) if stance.begin - rounding <= t), stances[0])
        after = next((stance for stance in stances if stance.begin - rounding > t), before)
        if t <= before.end + rounding or after is before:
            return before, before, 0.0
        return before, after, (t - before.end) / (after.begin - before.end)

    def pose(self, name: str, t: float) -> pin.SE3:
        """Return the pose of a contact's frame at ``t`` s, world, m."""
        before, after, s = self.around(name, t)
        if before is after:
            return before.pose
        start, end, part = before.pose.translation, after.pose.translation, smooth_step(s)
        if self.swing is None:
            position = start + part * (end - start) + [0.0, 0.0, self.clearance * swing_profile(s)]
        else:
            position = self.swing(name, start, end, s)
        return pin.SE3(blended(before.pose, after.pose, part).rotation, np.asarray(position, dtype=float))


def stances_of(
    schedule: Schedule, name: str, start: pin.SE3, landing: Callable[[int, float, float], pin.SE3]
) -> Iterator[Stance]:
    """Yield the stances of a contact in time order.

    Args:
        schedule: Phases and their contacts.
        name: Of the contact.
        start: Its pose at the start: a stance of no duration if it is in the air.
        landing: Its pose in the stance that begins with the phase of this index and lasts from ``begin`` to
            ``end``, s.
    """
    if name not in schedule.phases[0].contacts:
        yield Stance(begin=0.0, end=0.0, pose=start)
    ends = list(accumulate(phase.duration for phase in schedule.phases))
    for stands, group in groupby(range(len(ends)), lambda index: name in schedule.phases[index].contacts):
        if stands:
            phases = list(group)
            first, last = phases[0], phases[-1]
            begin, end = ends[first] - schedule.phases[first].duration, ends[last]
            yield Stance(begin=begin, end=end, pose=landing(first, begin, end) if first else start)


@checked
def stepped_posture(
    robot: Robot, q: np.ndarray, base: pin.SE3, contacts: Mapping[str, pin.SE3], *, move_base: bool = False
) -> Posture:
    """Return the posture with the base and contacts at poses, world, m, on the branch of the posture ``q``.

    Both move in small steps from where they are at ``q`` (nq,).

    Args:
        robot: A robot on a free-flyer.
        q: Configuration (nq,) from which the search starts.
        base: Placement of the base.
        contacts: Poses of the contacts' frames by name.
        move_base: Whether the base may move in the last step.
    """
    first, before, found = pin.XYZQUATToSE3(q[:7]), contact_poses(robot, q), Posture(q=q, error=np.inf)
    for step in range(1, STEPS + 1):
        part, last = step / STEPS, step == STEPS
        at = {name: pin.SE3.Interpolate(before[name], pose, part) for name, pose in contacts.items()}
        q = np.append(pin.SE3ToXYZQUAT(pin.SE3.Interpolate(first, base, part)), found.q[7:])
        found = inverse_kinematics(robot, q, contact_targets(robot, at), move_base=move_base and last)
    return found


def blended(start: pin.SE3, end: pin.SE3, part: float) -> pin.SE3:
    """Return the pose at a fraction of the straight line and the shortest turn between two poses."""
    position = (1 - part) * start.translation + part * end.translation
    turn = pin.exp3(part * pin.log3(start.rotation.T @ end.rotation))
    return pin.SE3(start.rotation @ turn, position)


class RememberedMotion:
    """A motion ``t -> q`` with a cache of its postures, which is not pickled."""

    def __init__(self, motion: Motion) -> None:
        self.motion, self._at = motion, lru_cache(maxsize=CACHED_POSTURES)(motion)

    def __call__(self, t: float) -> np.ndarray:
        """Configuration (nq,) at time ``t`` in s."""
        return self._at(t)

    def __reduce__(self) -> tuple[type[RememberedMotion], tuple[Motion]]:
        """Pickle without the cache."""
        return RememberedMotion, (self.motion,)
