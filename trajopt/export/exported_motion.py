"""A motion as exported: evenly sampled, cycle after cycle, with joints and links by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trajopt.arguments import Positive, PositiveCount, checked
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.export.formats import RATE
from trajopt.export.links import LinkMotion, link_motion
from trajopt.motion.consistency import SAME_TIME
from trajopt.motion.cycles import in_passes, passes_of
from trajopt.motion.input import SolutionOrFile, require_motion, solution_of
from trajopt.motion.sampled_motion import MOST_SAMPLES, SampledMotion
from trajopt.motion.solution import Solution

# Largest rate of a motion that ends at rest, relative to its largest rate: solvers leave less.
AT_REST = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """The d joints other than a moving base at n times, in Pinocchio's order; SI units.

    names: (d,). position: (n, d), with whole turns. velocity, acceleration: (n, d).
    torque: (n, d) of the drives; 0 for passive joints.
    """

    names: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(cls, motion: SampledMotion) -> JointMotion:
        """Read the joints of a motion; raises `InputError` for one with several degrees of freedom."""
        single = Coordinates(motion.model).joints[BASE_JOINT[motion.base] :]
        for joint in single:
            if joint.v.stop - joint.v.start != 1:
                raise InputError(
                    f"joint '{joint.name}' has several degrees of freedom",
                    "allowed: one, beside a moving base",
                )
        rows = np.array([joint.v.start for joint in single], dtype=int)
        position = motion.q[:, [joint.q.start for joint in single]]
        for column, joint in enumerate(single):
            if joint.is_counted:
                position[:, column] = counted_angle(motion.q[:, joint.q], motion.v[:, rows[column]], motion.t)
        return cls(
            names=tuple(joint.name for joint in single),
            position=position,
            velocity=motion.v[:, rows],
            acceleration=motion.a[:, rows],
            torque=motion.actuation.force(motion.drive_torque)[:, rows],
        )


def counted_angle(q: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Angle (n,), rad, of a joint at times ``t`` (n,) from its cosine and sine (n, 2) and its rate (n,).

    The rate tells how many whole turns the joint makes from sample to sample.
    """
    angle = np.arctan2(q[:, 1], q[:, 0])
    expected = (v[1:] + v[:-1]) / 2 * np.diff(t)
    turns = np.round((expected - np.diff(angle)) / (2 * np.pi))
    return np.asarray(angle + 2 * np.pi * np.append(0.0, np.cumsum(turns)))


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportedMotion(SampledMotion):
    """A motion at n times, ``rate`` per second from 0 s, of all cycles one after the other.

    Args:
        plan: the solution.
        rate: samples per second, Hz.
        joints: the joints other than a moving base.
    """

    plan: Solution
    rate: float
    joints: JointMotion

    @cached_property
    def links(self) -> LinkMotion:
        """Poses and velocities of all links, in the world."""
        return link_motion(self.model, self.q, self.v)


@checked
def sample_cycles(
    solution: SolutionOrFile, rate: Positive = RATE, cycles: PositiveCount = 1, *, even: bool = True
) -> ExportedMotion:
    """Sample a motion at ``rate`` from the polynomials of its intervals; a switch has the values after it.

    Args:
        solution: the plan, or the path of its file.
        rate: samples per second, Hz.
        cycles: of a periodic plan, each continuing the previous one; half a cycle counts with its mirror
            image, as in `simulate`.
        even: whether all steps are equal. A remainder at the end shorter than a step is then a whole step if
            the motion ends at rest, else it is left out. If not, it is the last step.

    Raises:
        InputError: for a rate that gives over 200,000 samples, several cycles of a plan that is not periodic,
            or joints other than the base with several degrees of freedom.
    """
    plan = require_motion(solution_of(solution))
    passes = passes_of(plan, cycles)
    start, end = float(plan.interval_t[0, 0]), float(plan.interval_t[-1, 1])
    slack, duration = SAME_TIME * (end - start), (end - start) * passes
    times = _even_times(duration, rate)
    if duration - times[-1] > slack and (not even or _ends_at_rest(plan)):
        times = np.append(times, len(times) / rate if even else duration)
    number = np.clip(np.floor((times + slack) / (end - start)).astype(int), 0, passes - 1)
    samples = plan.sample(times=np.clip(start + times - number * (end - start), start, end))
    moved = replace(in_passes(plan, samples, number), t=times)
    return ExportedMotion(**vars(moved), plan=plan, rate=float(rate), joints=JointMotion.of(moved))


def _even_times(duration: float, rate: float) -> np.ndarray:
    steps = duration * rate
    if steps >= MOST_SAMPLES:
        raise InputError(
            f"rate is {rate:g} Hz, {steps:.3g} samples in {duration:g} s", f"allowed: {MOST_SAMPLES} samples"
        )
    return np.arange(int(steps * (1 + SAME_TIME) + SAME_TIME) + 1) / rate


def _ends_at_rest(plan: Solution) -> bool:
    return bool(np.abs(plan.v[-1]).max() <= AT_REST * np.abs(plan.v).max())


def require_one_robot(motions: Sequence[ExportedMotion]) -> None:
    """Raise `InputError` for motions of different robots."""
    robots = {motion.robot for motion in motions}
    if len(robots) > 1:
        raise InputError(f"motions of {len(robots)} robots: {', '.join(sorted(robots))}", "allowed: of one")
