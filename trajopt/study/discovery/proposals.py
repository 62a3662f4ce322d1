"""Candidates: modes from relaxed contacts and from known gaits and hops, each with a motion to start from."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.reduced.base_path import BaseWaypoint, flights
from trajopt.reduced.gaits import Pace, plan_of_cycle
from trajopt.reduced.legged import legged_guess
from trajopt.schedule.gait_transitions import transition
from trajopt.schedule.gaits import Gait, gait_names, gait_of
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.study.discovery.modes import ModeSequence
from trajopt.study.discovery.records import Candidate
from trajopt.study.discovery.relaxation import relaxed_motion
from trajopt.study.discovery.task import ContactTask
from trajopt.terms.tracking import KeyFrames

# Relaxed motions with more slack than this are rejected: their feet still push from a distance.
MOST_SLACK = 0.01
# Samples of a stored motion.
SAMPLES = 201
# Fractions of the duration of known motions that are not cycles: push, flight and landing of a hop; standing
# at either end of steps.
HOP = (0.4, 0.2, 0.4)
STAND = 0.15
MOST_CYCLES = 3


def relaxed_name(seed: int, fine: bool = False) -> str:
    """Name of the source of a relaxed motion."""
    return f"relaxed:{seed}" + (":fine" if fine else "")


def relaxed_proposal(task: ContactTask, seed: int, max_time: float, fine: bool = False) -> Candidate:
    """Propose the modes of a relaxed motion, with at most ``max_time`` s of solver time."""
    relaxed = relaxed_motion(task, seed=seed, max_time=max_time, fine=fine)
    solution, modes, slack = relaxed.solution, relaxed.modes, relaxed.slack
    candidate = Candidate(
        source=relaxed_name(seed, fine), slack=slack, seconds=relaxed.seconds, effort=relaxed.effort
    )
    if solution is None or modes is None or slack is None:
        return replace(candidate, why="no relaxed motion was found")
    candidate = replace(candidate, relaxed_objective=solution.statistics.objective)
    if slack > MOST_SLACK:
        why = f"contacts could not be tightened below a slack of {slack:g} (asked {MOST_SLACK:g})"
        return replace(candidate, why=why)
    shift = modes.shift if task.periodic else 0.0
    return replace(candidate, modes=modes, motion=key_frames(task, solution, shift))


def key_frames(task: ContactTask, solution: Solution, shift: float = 0.0) -> KeyFrames:
    """The motion of a solution; for a cycle, starting at ``shift`` s."""
    times = np.linspace(0.0, float(solution.t[-1]), SAMPLES)
    q = solution.sample(times=times).q
    if shift:
        times, q = _turned(task, q, times, shift)
    return KeyFrames(task.robot, times, q)


def _turned(
    task: ContactTask, q: np.ndarray, times: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a cycle starting at ``shift`` s, cut from two cycles and moved to the original start."""
    duration = times[-1]
    cycle = task.travel(q[0], q[-1])
    shift = shift % duration
    twice = np.concatenate([q[:-1], np.array([task.moved(each, cycle) for each in q])])
    begins = np.concatenate([times[:-1], times + duration]) - shift
    kept = (begins >= -times[1]) & (begins <= duration + times[1])
    first = twice[np.flatnonzero(kept)[0]]
    back = -task.travel(q[0], first)
    back[2] = 0.0
    return begins[kept], np.array([task.moved(each, back) for each in twice[kept]])


def known_proposals(task: ContactTask) -> Iterator[Candidate]:
    """Yield known gaits for a cycle, else hops and steps from standing to standing, if the robot has any."""
    for source, phases in _known(task):
        modes = ModeSequence(tuple((phase.contacts, phase.duration) for phase in phases))
        try:
            motion = _known_motion(task, Schedule(phases))
        except InputError as error:
            yield Candidate(source=source, why=f"{error}")
            continue
        times = np.linspace(0.0, modes.duration, SAMPLES)
        frames = KeyFrames(task.robot, times, np.array([motion(float(t)) for t in times]))
        yield Candidate(source=source, modes=modes, motion=frames)


def _known(task: ContactTask) -> Iterator[tuple[str, tuple[Phase, ...]]]:
    robot, duration = task.robot, task.duration
    names = tuple(contact.name for contact in robot.contacts)
    try:
        gaits = gait_names(robot)
    except InputError:
        gaits = ()
    if task.periodic:
        for name in gaits:
            yield f"gait:{name}", gait_of(robot, name).phases(duration)
        return
    push, flight, landing = (
        Phase(name=name, duration=part * duration, contacts=feet)
        for name, part, feet in zip(("push", "flight", "landing"), HOP, (names, (), names), strict=True)
    )
    yield "hop", (push, flight, landing)
    for name in gaits:
        gait = gait_of(robot, name)
        if not all(support.feet for support in gait.supports()):
            continue  # steps between two standing postures have no flights
        for cycles in range(1, MOST_CYCLES + 1):
            period, stand = duration * (1 - 2 * STAND) / cycles, STAND * duration
            try:
                phases = transition(gait, period, cycles=cycles, stand=stand, rest=stand)
            except InputError:  # too few cycles to lift every foot
                continue
            scale = duration / sum(phase.duration for phase in phases)
            scaled = [(phase.name, scale * phase.duration, phase.contacts) for phase in phases]
            yield f"steps:{name}:{cycles}", tuple(Phase(name=n, duration=d, contacts=c) for n, d, c in scaled)


def _known_motion(task: ContactTask, schedule: Schedule) -> Motion:
    """Straight path of the base with legs by inverse kinematics; without a free-flying base, legs at rest."""
    robot, duration = task.robot, task.duration
    if robot.base != "freeflyer":
        return task.still
    first, last = task.still(0.0), task.still(duration)
    way = task.travel(first, last)
    if task.periodic:
        pace = Pace(velocity=(way[0] / duration, way[1] / duration))
        return plan_of_cycle(robot, schedule, pace, mirror=None, clearance=1.5 * task.clearance).guess
    turn = pin.log3(pin.Quaternion(last[3:7]).matrix() @ pin.Quaternion(first[3:7]).matrix().T)
    times = sorted({0.0, duration, *(time for flight in flights(schedule) for time in flight)})
    parts = np.diff([0.0, *times]) / duration
    path = [
        BaseWaypoint(time=time, position=first[:3] + way * time / duration, turn=part * turn)
        for time, part in zip(times, parts, strict=True)
    ]
    return legged_guess(robot, schedule, path, start=first, terrain=task.problem.terrain)


def nearest_gait(task: ContactTask, modes: ModeSequence) -> tuple[str, float] | None:
    """The known gait nearest in touchdowns and duty factors, and its distance in periods, or None."""
    try:
        names = gait_names(task.robot)
    except InputError:
        return None
    gait = _as_gait(modes)
    if gait is None or not task.periodic:
        return None
    away = {name: _apart(gait, gait_of(task.robot, name)) for name in names}
    best = min(away, key=lambda name: away[name])
    return best, away[best]


def _as_gait(modes: ModeSequence) -> Gait | None:
    """Read duty factors and touchdowns from a cycle in which every foot steps once; None for other cycles."""
    duty, offsets = modes.duty(), {}
    begins = np.cumsum([0.0, *(duration for _, duration in modes.modes)]) / modes.duration
    for foot in sorted(duty):
        on = [foot in contacts for contacts in modes.key]
        lands = [i for i in range(len(on)) if on[i] and not on[i - 1]]
        if len(lands) != 1:
            return None
        offsets[foot] = float(begins[lands[0]])
    return Gait(name="read", duty=duty, offsets=offsets) if duty else None


def _apart(one: Gait, other: Gait) -> float:
    """Mean difference of touchdowns at the best time shift, plus half that of duty factors, in periods."""
    feet = [foot for foot in other.feet if foot in one.feet]
    if len(feet) < len(other.feet):
        return 1.0
    lags = np.array([one.offsets[foot] - other.offsets[foot] for foot in feet])
    apart = min(np.abs((lags - lag + 0.5) % 1.0 - 0.5).mean() for lag in lags)
    return float(apart + np.mean([abs(one.duty_of(foot) - other.duty_of(foot)) for foot in feet]) / 2)
