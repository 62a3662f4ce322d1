"""A guess for the full problem from a solution on one rigid body: its base, legs by inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pinocchio as pin
from scipy.interpolate import BPoly, CubicHermiteSpline

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.guesses.foot_motion import (
    CACHED_POSTURES,
    DEFAULT_CLEARANCE,
    FootMotion,
    FootSwing,
    foot_targets,
)
from trajopt.problem.problem import Problem
from trajopt.reduced.footsteps import Foothold, feet_of
from trajopt.reduced.single_rigid_body import footholds_of
from trajopt.robot.kinematics import inverse_kinematics
from trajopt.schedule.schedule import Motion
from trajopt.solution.solution import Solution
from trajopt.terrain.swing_profile import smooth_step


class BasePath:
    """Placement of the free-flyer over time through a solution's samples, twice differentiable in a phase.

    Positions by quintics through position, velocity and acceleration; rotations by cubics in exponential
    coordinates relative to the sample before. ``durations`` of the phases in s, default the solution's: the
    path is stretched to them.
    """

    def __init__(self, solution: Solution, durations: Sequence[float] | None = None) -> None:
        self._pieces = [_PhasePath(solution, rows) for rows in solution.phases]
        spans = [piece.t[-1] - piece.t[0] for piece in self._pieces] if durations is None else durations
        self._starts = np.concatenate([[0.0], np.cumsum(spans)])

    def __call__(self, t: float) -> pin.SE3:
        """Placement at ``t`` in s; at a time between two phases that of the later one; times are clipped."""
        i = int(np.searchsorted(self._starts[1:-1], t, side="right"))
        times = self._pieces[i].t
        fraction = (t - self._starts[i]) / (self._starts[i + 1] - self._starts[i])
        return self._pieces[i].placement(float(times[0] + fraction * (times[-1] - times[0])))


class _PhasePath:
    def __init__(self, solution: Solution, rows: range) -> None:
        t = solution.t[rows.start : rows.stop]
        first = np.append(True, np.diff(t) > 0)
        index = np.arange(rows.start, rows.stop)[first]
        q, v, a = solution.q[index], solution.v[index], solution.a[index]
        self.t = solution.t[index]
        self.rotations = [pin.Quaternion(*row[[6, 3, 4, 5]]).toRotationMatrix() for row in q]
        turned = np.array(self.rotations)
        velocity = np.einsum("kij,kj->ki", turned, v[:, :3])
        acceleration = np.einsum("kij,kj->ki", turned, a[:, :3] + np.cross(v[:, 3:6], v[:, :3]))
        self.position = BPoly.from_derivatives(self.t, np.stack([q[:, :3], velocity, acceleration], axis=1))
        self.turns = [self._turn(k, v[:, 3:6]) for k in range(len(self.t) - 1)]

    def _turn(self, k: int, omega: np.ndarray) -> CubicHermiteSpline:
        """theta(t) from sample k to the next: theta' = omega at its start, Jlog(theta) omega at its end."""
        relative = self.rotations[k].T @ self.rotations[k + 1]
        rates = np.array([omega[k], pin.Jlog3(relative) @ omega[k + 1]])
        return CubicHermiteSpline(self.t[k : k + 2], np.array([np.zeros(3), pin.log3(relative)]), rates)

    def placement(self, t: float) -> pin.SE3:
        time = float(np.clip(t, self.t[0], self.t[-1]))
        k = int(np.clip(np.searchsorted(self.t, time, side="right") - 1, 0, len(self.turns) - 1))
        return pin.SE3(self.rotations[k] @ pin.exp3(self.turns[k](time)), self.position(time))


@dataclass(frozen=True, kw_only=True, eq=False)
class _LegPosture:
    """Base on its path, feet on their footholds; swings in the world, or carried by the base in flight."""

    problem: Problem
    base: Callable[[float], pin.SE3]
    clearance: float

    @cached_property
    def feet(self) -> FootMotion:
        initial = feet_of(self.problem.robot, self.problem.initial_q)
        return FootMotion(plan=footholds_of(self.problem), initial=initial, clearance=self.clearance)

    def __call__(self, t: float) -> np.ndarray:
        placement, robot = self.base(t), self.problem.robot
        q = robot.reference.copy()
        q[:7] = pin.SE3ToXYZQUAT(placement)
        return inverse_kinematics(
            robot, q, foot_targets(robot, lambda name: self._foot(name, t, placement))
        ).q

    def _foot(self, name: str, t: float, placement: pin.SE3) -> Foothold:
        swing = self.feet.at(name, t)
        if not (isinstance(swing, FootSwing) and swing.airborne):
            return self.feet.foothold(name, t)
        part = smooth_step(swing.fraction)
        before, after = (
            self.base(when).actInv(foot.position)
            for when, foot in zip(swing.times, (swing.start, swing.end), strict=True)
        )
        carried = placement.act((1 - part) * before + part * after)
        return Foothold(position=carried, yaw=self.feet.foothold(name, t).yaw)


@checked
def guess_from_srb(problem: Problem, solution: Solution, *, clearance: float = DEFAULT_CLEARANCE) -> Motion:
    """Return a guess ``t -> q`` (nq,) for a problem from the solution of its `body_problem`.

    Args:
        problem: The problem of the whole robot.
        solution: Of one body: a single free-flyer, with the problem's phases.
        clearance: Height of swings while other feet stand, m.

    Raises:
        InputError: For another solution.
    """
    names = [phase.name for phase in problem.schedule.phases]
    phases = list(solution.phase_names)
    if solution.q.shape[1] != 7 or phases != names:
        raise InputError(
            f"the solution has {solution.q.shape[1]} coordinates and phases {phases}",
            f"allowed: a free-flyer, 7, and phases {names}",
        )
    durations = [phase.duration for phase in problem.schedule.phases]
    posture = _LegPosture(problem=problem, base=BasePath(solution, durations), clearance=clearance)
    return lru_cache(maxsize=CACHED_POSTURES)(posture.__call__)
