"""The default guess of a problem: from goal to goal, with feet where they stand and parabolas in flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_POSITION
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.problem.periodicity import Periodicity
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses, frame_pose, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.moment import Target
from trajopt.schedule.placing import landing_place
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.interfaces import Term
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_paths import smooth_step, swing_profile
from trajopt.terrain.terrain import Terrain

# Height of swings as a fraction of the robot's length; more than terms usually require.
SWING = 0.15
# Times of goals that differ by less than this fraction of the schedule's duration count as one.
SAME_TIME = 1e-9
# Cached configurations: a guess is evaluated three times at every point.
CACHED_POSTURES = 4096


@checked
def default_guess(
    robot: Robot,
    schedule: Schedule,
    terms: Sequence[Term],
    *,
    terrain: Terrain | None = None,
    start: np.ndarray | None = None,
    periodicity: Periodicity | None = None,
) -> Motion:
    """Return a guess ``t -> q`` (nq,) through the goals of the terms, each at its nominal time.

    Configurations are interpolated between goals, at rest at each goal. A contact stands on its foothold,
    else on its ground below where the motion brings it, and swings in an arc in between; limbs follow by
    inverse kinematics. A phase without contacts adds the parabola of a free fall. Without a goal at its end,
    a periodic motion ends at the image of its start, and any other stays at its last goal.

    Args:
        robot: The robot.
        schedule: Phases, contacts and footholds.
        terms: Their `Term.targets` are the goals; those out of reach are approached as far as possible.
        terrain: Ground of contacts without a surface of their own; default: level.
        start: Configuration (nq,) at the start; default: the reference.
        periodicity: Of the motion.
    """
    first = np.array(robot.reference if start is None else start, dtype=float)
    ground, ends = terrain or FlatGround(), tuple(accumulate(phase.duration for phase in schedule.phases))
    made = _Guess(robot=robot, schedule=schedule, terrain=ground, ends=ends, knots=((0.0, first),))
    goals = _goals(schedule, ends, terms)
    if periodicity is not None and ends[-1] not in goals and robot.base != "fixed":
        image, n = first.copy(), BASE_POSITION[robot.base]
        moved = periodicity.moved(ends[-1])
        image[:n] += moved if n == 3 else moved[[0, 2]]
        goals[ends[-1]] = [Target(q=image)]
    for time in sorted(goals):
        made = made.through(time, goals[time])
    return RememberedMotion(made)


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


def _goals(schedule: Schedule, ends: Sequence[float], terms: Sequence[Term]) -> dict[float, list[Target]]:
    goals: dict[float, list[Target]] = {}
    for target in (target for term in terms for target in term.targets()):
        time = ends[-1]
        if target.at.phase is not None:
            index = schedule.names.index(target.at.phase)
            time = ends[index] - (1.0 - target.at.fraction) * schedule.phases[index].duration
        same = next((known for known in goals if abs(known - time) <= SAME_TIME * ends[-1]), time)
        goals.setdefault(same, []).append(target)
    return goals


@dataclass(frozen=True)
class _Stance:
    """A contact that stands from ``begin`` to ``end``, s, with its frame at ``pose``."""

    begin: float
    end: float
    pose: pin.SE3


@dataclass(frozen=True, kw_only=True)
class _Guess:
    """A motion through ``knots``, (time in s, configuration); ``ends`` are those of the phases, s."""

    robot: Robot
    schedule: Schedule
    terrain: Terrain
    ends: tuple[float, ...]
    knots: tuple[tuple[float, np.ndarray], ...]

    def through(self, time: float, targets: Sequence[Target]) -> _Guess:
        """The motion extended to goals at a time after its last knot."""
        q = next((np.array(target.q) for target in targets if target.q is not None), None)
        if q is None:
            q = self._reaching(time, targets)
        return replace(self, knots=(*(self.knots if time > 0 else ()), (time, q)))

    def _reaching(self, time: float, targets: Sequence[Target]) -> np.ndarray:
        """Posture (nq,) with frames at their goals, and the contacts of that time where they stand.

        Inverse kinematics begins with the base moved by the mean displacement of its contacts.
        """
        q, n = self.knots[-1][1].copy(), BASE_POSITION[self.robot.base]
        standing = {
            name: stance.pose
            for name, stances in self.stances.items()
            for stance in stances
            if stance.begin <= time <= stance.end
        }
        if n:
            before = contact_poses(self.robot, q)
            ways = [pose.translation - before[name].translation for name, pose in standing.items()]
            moved = np.mean(ways or [np.zeros(3)], axis=0)
            q[:n] += moved if n == 3 else moved[[0, 2]]
        wanted = self._targets(standing)
        for target in targets:
            wanted[str(target.frame)] = _goal_of(self.robot, q, target)
        return inverse_kinematics(self.robot, q, wanted, move_base=bool(n)).q if wanted else q

    def __call__(self, t: float) -> np.ndarray:
        """Configuration at time ``t`` in s."""
        robot, n = self.robot, BASE_POSITION[self.robot.base]
        q, hop = self._carried(t), np.array([0.0, 0.0, self._hop(t)])
        if n:
            q[:n] += hop if n == 3 else hop[[0, 2]]
        phase, lift = self.schedule.phases[self._phase_at(t)], SWING * robot.length
        poses = {
            name: pin.SE3(pose.rotation, pose.translation + hop)
            for name, pose in ((name, _at(stances, t, lift)) for name, stances in self.stances.items())
            if n or name in phase.contacts
        }
        targets = self._targets(poses)
        return inverse_kinematics(robot, q, targets).q if targets else q

    def _targets(self, poses: Mapping[str, pin.SE3]) -> dict[str, pin.SE3 | np.ndarray]:
        """Goals of inverse kinematics: positions of points, poses of soles."""
        contacts = {name: self.robot.contact(name) for name in poses}
        return {
            contact.frame: poses[name] if contact.kind == "surface" else poses[name].translation
            for name, contact in contacts.items()
        }

    def _carried(self, t: float) -> np.ndarray:
        """Configuration interpolated between the knots, regardless of contacts."""
        for (begin, before), (end, after) in zip(self.knots, self.knots[1:], strict=False):
            if t < end:
                part = smooth_step((t - begin) / (end - begin))
                return np.array(pin.interpolate(self.robot.model, before, after, part))
        return self.knots[-1][1].copy()

    def _phase_at(self, t: float) -> int:
        return min(int(np.searchsorted(self.ends, t, side="right")), len(self.ends) - 1)

    def _hop(self, t: float) -> float:
        index = self._phase_at(t)
        phase = self.schedule.phases[index]
        if phase.contacts or self.robot.base == "fixed":
            return 0.0
        left = self.ends[index] - t
        return max(0.0, gravity_of(self.robot.model) * left * (phase.duration - left) / 2)

    @cached_property
    def stances(self) -> Mapping[str, tuple[_Stance, ...]]:
        """Stances, in time order, of each contact that stands at some time."""
        used = {name for phase in self.schedule.phases for name in phase.contacts}
        return {c.name: tuple(self._stances_of(c)) for c in self.robot.contacts if c.name in used}

    def _stances_of(self, contact: Contact) -> Iterator[_Stance]:
        """Stances of a contact; one of zero duration at an end of the motion where it is in the air."""
        phases, name = self.schedule.phases, contact.name
        begins = (0.0, *self.ends[:-1])
        pose = contact_poses(self.robot, self.knots[0][1])[name]
        begin: float | None = 0.0
        for index, phase in enumerate(phases):
            if name in self.schedule.new_contacts(index):
                there = contact_poses(self.robot, self._carried(begins[index]))[name]
                place = landing_place(phase, contact, self.terrain, there.translation)
                begin, pose = begins[index], pin.SE3(there.rotation, place)
            stands = name in phase.contacts
            if not stands and begin is not None:
                yield _Stance(begin, begins[index], pose)
                begin = None
        if begin is None:
            yield _Stance(self.ends[-1], self.ends[-1], contact_poses(self.robot, self.knots[-1][1])[name])
        else:
            yield _Stance(begin, self.ends[-1], pose)


def _at(stances: Sequence[_Stance], t: float, lift: float) -> pin.SE3:
    """Pose of a contact at ``t`` s: where it stands, or on the arc to where it stands next."""
    before = next((stance for stance in reversed(stances) if stance.begin <= t), stances[0])
    after = next((stance for stance in stances if stance.begin > t), before)
    if t <= before.end or after is before:
        return before.pose
    part = (t - before.end) / (after.begin - before.end)
    s = smooth_step(part)
    way = (1 - s) * before.pose.translation + s * after.pose.translation
    rotation = pin.SE3.Interpolate(before.pose, after.pose, s).rotation
    return pin.SE3(rotation, way + np.array([0.0, 0.0, lift * swing_profile(part)]))


def _goal_of(robot: Robot, q: np.ndarray, target: Target) -> pin.SE3 | np.ndarray:
    """Goal of inverse kinematics: a position or a pose; for a rotation alone the frame keeps its position."""
    if target.rotation is None:
        return np.asarray(target.position)
    position = target.position
    if position is None:
        position = frame_pose(robot, q, str(target.frame)).translation
    return pin.SE3(np.array(target.rotation), np.array(position))
