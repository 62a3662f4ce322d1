"""The default guess of a problem: from goal to goal, with feet where they stand and parabolas in flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import BASE_POSITION
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.pickling import picklable
from trajopt.problem.contact_paths import SAME_TIME, ContactPaths, RememberedMotion, Stance, stances_of
from trajopt.problem.periodicity import Periodicity
from trajopt.robot.kinematics import contact_poses, contact_targets, frame_pose, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.moment import Moment, Target
from trajopt.schedule.placing import landing_place
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terms.frames import FrameHeight
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
    inverse kinematics. A phase without contacts adds the parabola of a free fall. A `FrameHeight` that this
    misses while contacts stand is one more goal. Without a goal at its end, a periodic motion ends at the
    image of its start, and any other stays at its last goal.

    Args:
        robot: The robot.
        schedule: Phases, contacts and footholds.
        terms: Their `Term.targets` are the goals; those out of reach are approached as far as possible.
        terrain: Ground of contacts without a surface of their own; default: level.
        start: Configuration (nq,) at the start; default: the reference.
        periodicity: Of the motion.
    """
    ground, end = terrain or FlatGround(), schedule.duration
    first = np.array(robot.reference if start is None else start, dtype=float)
    path = PosturePath(model=robot.model, postures=(first,), durations=())
    goals = _goals(schedule, terms)
    if periodicity is not None and end not in goals and robot.base != "fixed":
        goals[end] = [Target(q=_displaced(robot, first, periodicity.moved(end)))]
    for time in sorted(goals):
        q = next((np.array(target.q) for target in goals[time] if target.q is not None), None)
        if q is None:
            contacts = _contacts(robot, schedule, ground, path)
            q = _reaching(robot, path.postures[-1], contacts, time, goals[time])
        path = path.through(time, q)
    motion = _guided(robot, schedule, ground, path)
    heights = [(_time_of(term.at, schedule), term) for term in terms if isinstance(term, FrameHeight)]
    for time, term in heights:
        target = None if time in goals else _missed(term, motion, time)
        if target is not None:
            q = _reaching(robot, motion(time), motion.contacts, time, [target])
            motion = _guided(robot, schedule, ground, motion.path.through(time, q))
    return RememberedMotion(motion)


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
            contacts=ContactPaths(
                stances={name: tuple(stances(name)) for name in poses[0]}, clearance=0.0, swing=swing
            ),
            swinging=swinging,
        )
    )


@checked
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

    def through(self, time: float, q: np.ndarray) -> PosturePath:
        """Return the path with one more posture (nq,), or another one, at ``time`` in s."""
        times = accumulate(self.durations, initial=0.0)
        others = [knot for knot in zip(times, self.postures, strict=True) if knot[0] != time]
        knots = sorted([*others, (time, q)], key=lambda knot: knot[0])
        durations = [end - begin for (begin, _), (end, _) in pairwise(knots)]
        return replace(self, postures=[posture for _, posture in knots], durations=durations)


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedMotion:
    """A motion ``t -> q`` along a path of postures, whose limbs follow the contacts by inverse kinematics.

    Args:
        robot: The robot.
        schedule: A phase without contacts adds the parabola of a free fall, of the base and the contacts.
        path: The motion without contacts.
        contacts: Where contacts are.
        swinging: Contacts that follow ``contacts`` also in the air, unless another one on their link stands;
            the others are on the path there.
    """

    robot: Robot
    schedule: Schedule
    path: PosturePath
    contacts: ContactPaths
    swinging: Sequence[str]

    def __call__(self, t: float) -> np.ndarray:
        """Return the configuration (nq,) at ``t`` in s."""
        (phase, left), hop = self.phase_at(t), np.zeros(3)
        if not phase.contacts and self.robot.base != "fixed":
            hop[2] = max(0.0, gravity_of(self.robot.model) * left * (phase.duration - left) / 2)
        q, poses = _displaced(self.robot, self.path(t), hop), {}
        held = {self._link(name) for name in phase.contacts}
        for name in self.contacts.stances:
            if name in phase.contacts or (name in self.swinging and self._link(name) not in held):
                pose = self.contacts.pose(name, t)
                poses[name] = pin.SE3(pose.rotation, pose.translation + hop)
        return inverse_kinematics(self.robot, q, contact_targets(self.robot, poses)).q if poses else q

    def _link(self, name: str) -> int:
        """Joint that carries a contact: a heel in the air turns about the toes that stand."""
        model = self.robot.model
        return int(model.frames[model.getFrameId(self.robot.contact(name).frame)].parentJoint)

    def phase_at(self, t: float) -> tuple[Phase, float]:
        """Return the phase at ``t`` in s, and the time left of it, s."""
        ends = np.cumsum([phase.duration for phase in self.schedule.phases])
        index = min(int(np.searchsorted(ends, t, side="right")), len(ends) - 1)
        return self.schedule.phases[index], float(ends[index]) - t


def _displaced(robot: Robot, q: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Configuration (nq,) with the base, if it moves, displaced by ``way`` (3,) m, world."""
    moved, n = q.copy(), BASE_POSITION[robot.base]
    if n:
        moved[:n] += way if n == 3 else way[[0, 2]]
    return moved


def _goals(schedule: Schedule, terms: Sequence[Term]) -> dict[float, list[Target]]:
    goals: dict[float, list[Target]] = {}
    for target in (target for term in terms for target in term.targets()):
        time = _time_of(target.at, schedule)
        same = next((known for known in goals if abs(known - time) <= SAME_TIME * schedule.duration), time)
        goals.setdefault(same, []).append(target)
    return goals


def _time_of(moment: Moment, schedule: Schedule) -> float:
    """Nominal time of a moment, s."""
    index = len(schedule.phases) - 1 if moment.phase is None else schedule.names.index(moment.phase)
    ends = tuple(accumulate(phase.duration for phase in schedule.phases))
    return ends[index] - (1.0 - moment.fraction) * schedule.phases[index].duration


def _missed(term: FrameHeight, motion: GuidedMotion, time: float) -> Target | None:
    """The position of the term's frame at its height, if a motion misses that while contacts stand."""
    x, y, z = frame_pose(motion.robot, motion(time), term.frame).translation
    met = z <= term.height if term.below else z >= term.height
    if met or not motion.phase_at(time)[0].contacts:
        return None
    return Target(frame=term.frame, position=np.array([x, y, term.height]))


def _guided(robot: Robot, schedule: Schedule, terrain: Terrain, path: PosturePath) -> GuidedMotion:
    """Motion along a path; contacts of a robot that moves about follow their swings, too."""
    contacts = _contacts(robot, schedule, terrain, path)
    swinging = () if robot.base == "fixed" else tuple(contacts.stances)
    return GuidedMotion(robot=robot, schedule=schedule, path=path, contacts=contacts, swinging=swinging)


def _contacts(robot: Robot, schedule: Schedule, terrain: Terrain, path: PosturePath) -> ContactPaths:
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
    return ContactPaths(
        stances={c.name: tuple(stances(c.name)) for c in robot.contacts if c.name in used},
        clearance=SWING * robot.length,
    )


def _reaching(
    robot: Robot, q: np.ndarray, contacts: ContactPaths, time: float, targets: Sequence[Target]
) -> np.ndarray:
    """Posture (nq,) near ``q`` with frames at their goals, and the contacts of that time where they stand.

    Inverse kinematics begins with the base moved by the mean displacement of its contacts.
    """
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
