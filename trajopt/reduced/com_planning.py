"""Closed-form CoM trajectories from footsteps, by the divergent component of motion (see ``lip``)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from trajopt.errors import InputError
from trajopt.reduced.footsteps import FootstepPlan, StepPhase, support_vertices
from trajopt.reduced.lip import Pendulum, PendulumMotion, first_zmp_for
from trajopt.robot.robot import Robot

# Least-squares residual below which a point is in a polygon, m: rounding of foot positions.
INSIDE = 1e-9


class ComMotion(Protocol):
    """Horizontal motion of the centre of mass: (2,) vectors at a time in s, world axes, m."""

    def com(self, t: float) -> np.ndarray:
        """Position, m."""
        ...

    def velocity(self, t: float) -> np.ndarray:
        """Velocity, m/s."""
        ...

    def acceleration(self, t: float) -> np.ndarray:
        """Acceleration, m/s^2."""
        ...

    def zmp_at(self, t: float) -> np.ndarray:
        """Zero moment point, m."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class CubicMotion:
    """A CoM motion with constant jerk in each of n intervals: the pendulum with jerk as its input.

    times (n + 1,) s; states (n, 3, 2) position, velocity, acceleration at the start of each, jerk (n, 2).
    """

    pendulum: Pendulum
    times: np.ndarray
    states: np.ndarray
    jerk: np.ndarray

    def _state(self, t: float) -> np.ndarray:
        time = float(np.clip(t, self.times[0], self.times[-1]))
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.jerk) - 1))
        s, (c, v, a), j = time - self.times[k], self.states[k], self.jerk[k]
        return np.array([c + s * v + s**2 / 2 * a + s**3 / 6 * j, v + s * a + s**2 / 2 * j, a + s * j])

    def com(self, t: float) -> np.ndarray:
        """Centre of mass (2,), m."""
        return np.asarray(self._state(t)[0])

    def velocity(self, t: float) -> np.ndarray:
        """Its velocity (2,), m/s."""
        return np.asarray(self._state(t)[1])

    def acceleration(self, t: float) -> np.ndarray:
        """Its acceleration (2,), m/s^2."""
        return np.asarray(self._state(t)[2])

    def zmp_at(self, t: float) -> np.ndarray:
        """Zero moment point c - c'' / omega^2, (2,), m."""
        state = self._state(t)
        return np.asarray(state[0] - state[2] / self.pendulum.omega**2)


def analytic_motion(
    robot: Robot, plan: FootstepPlan, pendulum: Pendulum, com_start: np.ndarray
) -> PendulumMotion:
    """Closed-form walk from rest at ``com_start`` (2,) m, captured at its end: at rest but for exp(-omega T).

    The ZMP is linear in each support, from the middle of the feet shared with the previous support to the
    middle of those shared with the next: it is constant in single support. In the last support it reaches the
    middle after half the time. Its start follows from the start at rest. Raises InputError if that is outside
    the first support, which is then too short.
    """
    times, zmp = [0.0], []
    middles = [support_vertices(robot, support).mean(axis=0) for support in plan.supports]
    shared = [_shared_middle(robot, *pair) for pair in pairwise(plan.supports)]
    for i, support in enumerate(plan.supports):
        before = shared[i - 1] if i else None
        first = middles[i] if before is None else before
        if i < len(shared):
            after = shared[i]
            zmp.append([first, middles[i] if after is None else after])
            times.append(times[-1] + support.duration)
        else:
            zmp += [[first, middles[i]], [middles[i], middles[i]]]
            times += [times[-1] + support.duration / 2, times[-1] + support.duration]
    pieces = np.array(zmp)
    pieces[0, 0] = first_zmp_for(pendulum, np.array(times), pieces, com_start)
    support, begins = plan.supports[0], pieces[0, 0]
    if distance_outside(begins, support_vertices(robot, support)) > INSIDE:
        raise InputError(
            f"from rest the ZMP would begin outside support '{support.name}', at {np.round(begins, 3)} m",
            f"allowed: inside; make it longer than {support.duration:g} s",
        )
    return PendulumMotion(
        pendulum=pendulum, times=np.array(times), zmp=pieces, com_start=com_start, dcm_end=pieces[-1, 1]
    )


def _shared_middle(robot: Robot, support: StepPhase, other: StepPhase) -> np.ndarray | None:
    """Middle (2,) of the feet that both supports have, or None without any."""
    feet = {name: foot for name, foot in support.feet.items() if name in other.feet}
    return support_vertices(robot, replace(support, feet=feet)).mean(axis=0) if feet else None


def distance_outside(point: np.ndarray, vertices: np.ndarray) -> float:
    """Approximate distance (m) of a point (2,) from the convex hull of ``vertices`` (n, 2); 0 inside.

    Non-negative least squares over the vertices' weights, which holds for points and segments too.
    """
    from scipy.optimize import nnls  # takes a quarter of a second to load

    centred = np.vstack([(vertices - point).T, np.ones(len(vertices))])
    return float(nnls(centred, np.array([0.0, 0.0, 1.0]))[1])
