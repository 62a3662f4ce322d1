"""The default guess of a problem: from goal to goal, with feet where they stand and parabolas in flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_POSITION
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.pickling import picklable
from trajopt.problem.contact_motion import SAME_TIME, ContactMotion, RememberedMotion, Stance, stances_of
from trajopt.problem.periodicity import Periodicity
from trajopt.robot.kinematics import contact_poses, contact_targets, frame_pose, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.moment import Target
from trajopt.schedule.placing import landing_place
from trajopt.schedule.schedule import Motion, Schedule
from trajopt.terms.interfaces import Term
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.swing_paths import SwingPath, smooth_step
from trajopt.terrain.terrain import Terrain

# Height of swings as a fraction of the robot's length; more than terms usually require.
SWING = 0.15


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
    ground, ends = terrain or FlatGround(), tuple(accumulate(phase.duration for phase in schedule.phases))
    first = np.array(robot.reference if start is None else start, dtype=float)
    path = PosturePath(model=robot.model, postures=(first,), durations=())
    goals = _goals(schedule, ends, terms)
    if periodicity is not None and ends[-1] not in goals and robot.base != "fixed":
        image = _displaced(robot, first, periodicity.moved(ends[-1]))
        goals[ends[-1]] = [Target(q=image)]
    for time in sorted(goals):
        q = next((np.array(target.q) for target in goals[time] if target.q is not None), None)
        if q is None:
            q = _reaching(robot, path, _contacts(robot, schedule, ground, path), time, goals[time])
        path = path.extended(time, q)
    contacts = _contacts(robot, schedule, ground, path)
    carried = () if robot.base == "fixed" else tuple(contacts.stances)
    return RememberedMotion(
        GuidedMotion(robot=robot, schedule=schedule, path=path, contacts=contacts, swinging=carried)
    )


@checked
def posture_guess(
    robot: Robot,
    schedule: Schedule,
    postures: Sequence[np.ndarray],
    *,
    swinging: Sequence[str] = (),
    swing: SwingPath | None = None,
) -> Motion:
    """Return a guess ``t -> q`` (nq,) from posture to posture, at rest at the ends of phases.

    Contacts stand where the posture at the end of their first phase has them; limbs follow by inverse
    kinematics.

    Args:
        robot: The robot.
        schedule: Phases and their contacts.
        postures: Configurations (nq,), at the start and at the end of every phase.
        swinging: Contacts that swing between their stances, along ``swing``; others move with the postures.
        swing: Path of a swinging contact; default: a straight line.
    """
    poses = [contact_poses(robot, q) for q in postures]

    def stances(name: str) -> Iterator[Stance]:
        def landing(index: int, begin: float, end: float) -> pin.SE3:
            return poses[index + 1][name]

        return stances_of(schedule, name, poses[0][name], landing)

    durations = [phase.duration for phase in schedule.phases]
    return RememberedMotion(
        GuidedMotion(
            robot=robot,
            schedule=schedule,
            path=PosturePath(model=robot.model, postures=postures, durations=durations),
            contacts=ContactMotion(
                stances={name: tuple(stances(name)) for name in poses[0]}, clearance=0.0, swing=swing
            ),
            swinging=swinging,
        )
    )


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class PosturePath:
    """A motion from posture to posture, at rest at each, along 10 s^3 - 15 s^4 + 6 s^5; then still.

    Args:
        model: Of the robot.
        postures: Configurations (nq,), at least one.
        durations: From each posture to the next, s.
    """

    model: pin.Model
    postures: Sequence[np.ndarray]
    durations: Sequence[float]

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at ``t`` in s."""
        if not self.durations:
            return self.postures[0].copy()
        ends = np.cumsum(self.durations)
        index = min(int(np.searchsorted(ends, t, side="right")), len(ends) - 1)
        begin = ends[index - 1] if index else 0.0
        part = smooth_step((t - begin) / (ends[index] - begin))
        before, after = self.postures[index : index + 2]
        return np.asarray(pin.interpolate(self.model, before, after, part))

    def extended(self, time: float, q: np.ndarray) -> PosturePath:
        """Return the path with one more posture (nq,) at ``time`` in s, instead of the first one at zero."""
        if time <= 0:
            return replace(self, postures=(q,))
        durations = (*self.durations, time - sum(self.durations))
        return replace(self, postures=(*self.postures, q), durations=durations)


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedMotion:
    """A motion ``t -> q`` along a path of postures, whose limbs follow the contacts by inverse kinematics.

    Args:
        robot: The robot.
        schedule: A phase without contacts adds the parabola of a free fall, of the base and the contacts.
        path: The motion without contacts.
        contacts: Where contacts are.
        swinging: Contacts that follow ``contacts`` also in the air; the others are on the path there.
    """

    robot: Robot
    schedule: Schedule
    path: PosturePath
    contacts: ContactMotion
    swinging: Sequence[str]

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at ``t`` in s."""
        ends = np.cumsum([phase.duration for phase in self.schedule.phases])
        index = min(int(np.searchsorted(ends, t, side="right")), len(ends) - 1)
        phase, hop = self.schedule.phases[index], np.zeros(3)
        if not phase.contacts and self.robot.base != "fixed":
            left = float(ends[index]) - t
            hop[2] = max(0.0, gravity_of(self.robot.model) * left * (phase.duration - left) / 2)
        q, poses = _displaced(self.robot, self.path(t), hop), {}
        for name in self.contacts.stances:
            if name in self.swinging or name in phase.contacts:
                pose = self.contacts.pose(name, t)
                poses[name] = pin.SE3(pose.rotation, pose.translation + hop)
        return inverse_kinematics(self.robot, q, contact_targets(self.robot, poses)).q if poses else q


def _displaced(robot: Robot, q: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Configuration (nq,) with the base, if it moves, displaced by ``way`` (3,) m, world."""
    moved, n = q.copy(), BASE_POSITION[robot.base]
    if n:
        moved[:n] += way if n == 3 else way[[0, 2]]
    return moved


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


def _contacts(robot: Robot, schedule: Schedule, terrain: Terrain, path: PosturePath) -> ContactMotion:
    """Contacts that stand at some time: they land on the ground below the path, or end in the air on it."""

    def stances(name: str) -> Iterator[Stance]:
        def landing(index: int, begin: float, end: float) -> pin.SE3:
            there = contact_poses(robot, path(begin))[name]
            place = landing_place(schedule.phases[index], robot.contact(name), terrain, there.translation)
            return pin.SE3(there.rotation, place)

        yield from stances_of(schedule, name, contact_poses(robot, path.postures[0])[name], landing)
        if name not in schedule.phases[-1].contacts:
            last = contact_poses(robot, path.postures[-1])[name]
            yield Stance(begin=schedule.duration, end=schedule.duration, pose=last)

    used = {name for phase in schedule.phases for name in phase.contacts}
    return ContactMotion(
        stances={c.name: tuple(stances(c.name)) for c in robot.contacts if c.name in used},
        clearance=SWING * robot.length,
    )


def _reaching(
    robot: Robot, path: PosturePath, contacts: ContactMotion, time: float, targets: Sequence[Target]
) -> np.ndarray:
    """Posture (nq,) with frames at their goals, and the contacts of that time where they stand.

    Inverse kinematics begins with the base moved by the mean displacement of its contacts.
    """
    q = path.postures[-1]
    standing = {
        name: stance.pose
        for name, stances in contacts.stances.items()
        for stance in stances
        if stance.begin <= time <= stance.end
    }
    before = contact_poses(robot, q)
    ways = [pose.translation - before[name].translation for name, pose in standing.items()]
    q = _displaced(robot, q, np.mean(ways or [np.zeros(3)], axis=0))
    wanted = contact_targets(robot, standing)
    for target in targets:
        wanted[str(target.frame)] = _goal_of(robot, q, target)
    return inverse_kinematics(robot, q, wanted, move_base=robot.base != "fixed").q if wanted else q


def _goal_of(robot: Robot, q: np.ndarray, target: Target) -> pin.SE3 | np.ndarray:
    """Goal of inverse kinematics: a position or a pose; for a rotation alone the frame keeps its position."""
    if target.rotation is None:
        return np.asarray(target.position)
    position = target.position
    if position is None:
        position = frame_pose(robot, q, str(target.frame)).translation
    return pin.SE3(np.array(target.rotation), np.array(position))
