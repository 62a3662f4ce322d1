"""Linear inverted pendulum in closed form: motion, orbital energy, capture point, walking on footsteps.

A point mass at constant height z over its zero moment point (ZMP) p, ground height 0, per axis:

    c'' = omega^2 (c - p),     omega = sqrt(g / z)

The divergent component of motion xi = c + c' / omega (the instantaneous capture point) and the CoM obey

    xi' = omega (xi - p),      c' = -omega (c - xi)

so that only xi can diverge (Kajita et al. 2001; Pratt et al. 2006; Englsberger, Ott, Albu-Schäffer
2015; Koolen et al. 2012 for capturability). Where the ZMP is linear in time, p = p0 + r s,

    c = p + grow exp(omega s) + decay exp(-omega s)

exactly; a motion is a sequence of such pieces. Horizontal vectors have 2 entries, metres.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.errors import InputError, finite_array, require_positive
from trajopt.pickling import picklable
from trajopt.reduced.footsteps import FootstepPlan, support_vertices
from trajopt.robot.robot import Robot

# Least-squares residual below which a point is in a polygon, m: rounding of foot positions.
INSIDE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """Linear inverted pendulum.

    Args:
        height: of the centre of mass over the ground, m.
        gravity: m/s^2.

    Raises:
        InputError: for numbers that are not above zero.
    """

    height: float
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        for name in ("height", "gravity"):
            require_positive(f"{name} of the pendulum", getattr(self, name))

    @property
    def omega(self) -> float:
        """Natural frequency sqrt(g / z), 1/s."""
        return math.sqrt(self.gravity / self.height)

    def after(
        self, com: np.ndarray, velocity: np.ndarray, zmp: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """CoM and its velocity (2,) after ``time`` (s, either sign) over a constant ZMP (2,)."""
        cosh, sinh = math.cosh(self.omega * time), math.sinh(self.omega * time)
        offset = np.asarray(com) - zmp
        return (
            zmp + offset * cosh + np.asarray(velocity) / self.omega * sinh,
            offset * self.omega * sinh + np.asarray(velocity) * cosh,
        )

    def capture_point(self, com: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """ZMP over which the pendulum comes to rest: c + c' / omega, (2,)."""
        return np.asarray(com) + np.asarray(velocity) / self.omega

    def dcm_after(self, dcm: np.ndarray, zmp: np.ndarray, time: float) -> np.ndarray:
        """Divergent component (2,) after ``time`` over a constant ZMP: p + exp(omega t) (xi - p)."""
        return zmp + math.exp(self.omega * time) * (np.asarray(dcm) - zmp)

    def orbital_energy(self, com: np.ndarray, velocity: np.ndarray, zmp: np.ndarray) -> np.ndarray:
        """c'^2 / 2 - omega^2 (c - p)^2 / 2 for each axis (2,), J/kg; constant while the ZMP is.

        Positive: the CoM passes over the ZMP; negative: it turns back; zero: it comes to rest over it
        or leaves it from rest.
        """
        return np.asarray(velocity) ** 2 / 2 - self.omega**2 * (np.asarray(com) - zmp) ** 2 / 2

    def capture_radius(self, steps: int, step_time: float, reach: float) -> float:
        """Largest |xi - p| in m from which ``steps`` steps bring the point-foot pendulum to rest.

        Each step comes after ``step_time`` at least and is at most ``reach`` long:
        d_0 = 0, d_N = (d_(N-1) + reach) exp(-omega T) (Koolen et al. 2012, eq. 23).
        """
        radius = 0.0
        for _ in range(steps):
            radius = (radius + reach) * math.exp(-self.omega * step_time)
        return radius


def dcm_at_steps(
    pendulum: Pendulum, zmps: Sequence[np.ndarray], durations: Sequence[float], final: np.ndarray
) -> np.ndarray:
    """Divergent component (n + 1, 2) at the ends of steps over constant ZMPs, backwards from the last.

    xi_k = p_k + exp(-omega T_k) (xi_(k+1) - p_k), with xi_n = ``final`` (2,): the only bounded one.
    """
    dcm = [np.asarray(final, dtype=float)]
    for zmp, duration in zip(reversed(list(zmps)), reversed(list(durations)), strict=True):
        dcm.append(pendulum.dcm_after(dcm[-1], np.asarray(zmp), -duration))
    return np.array(dcm[::-1])


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class PendulumMotion:
    """The bounded CoM motion over a ZMP that is linear in each of n pieces, from c(0) and xi(T).

    times: (n + 1,) s. zmp: (n, 2, 2) ZMP at the start and the end of each piece, m; it may jump between
    pieces. com_start, dcm_end: (2,) CoM at the start, divergent component at the end, m.

    The divergent component is computed backwards, the CoM forwards: the direction in which each is stable, so
    that walks of any length are accurate. With the slope r of a piece,
    xi_k = p_k + r / omega + exp(-omega T) (xi_(k+1) - p_(k+1) - r / omega) (Englsberger et al. 2015).
    The velocity at the start follows: c'(0) = omega (xi(0) - c(0)).
    """

    pendulum: Pendulum
    times: np.ndarray
    zmp: np.ndarray
    com_start: np.ndarray
    dcm_end: np.ndarray

    def __post_init__(self) -> None:
        n = max(len(self.times) - 1, 1)
        for name, shape in (("times", (n + 1,)), ("zmp", (n, 2, 2)), ("com_start", (2,)), ("dcm_end", (2,))):
            array = finite_array(f"{name} of a pendulum's motion", getattr(self, name), shape)
            object.__setattr__(self, name, array)
        if not (np.diff(self.times) > 0).all():
            raise InputError(f"times of a pendulum's motion are {self.times}", "allowed: increasing")

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope of the ZMP, coefficients of the growing and of the decaying exponential, (n, 2) each."""
        omega, durations = self.pendulum.omega, np.diff(self.times)
        slope = (self.zmp[:, 1] - self.zmp[:, 0]) / durations[:, None]
        grow, decay = np.zeros_like(slope), np.zeros_like(slope)
        dcm, com = self.dcm_end, self.com_start
        for k in reversed(range(len(durations))):
            ahead = slope[k] / omega
            grow[k] = math.exp(-omega * durations[k]) * (dcm - self.zmp[k, 1] - ahead) / 2
            dcm = self.zmp[k, 0] + ahead + 2 * grow[k]
        for k, duration in enumerate(durations):
            decay[k] = com - self.zmp[k, 0] - grow[k]
            com = (
                self.zmp[k, 1] + grow[k] * math.exp(omega * duration) + decay[k] * math.exp(-omega * duration)
            )
        return slope, grow, decay

    def _at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """ZMP, its slope, growing and decaying part at ``t``."""
        last = len(self.zmp) - 1
        time = float(np.clip(t, self.times[0], self.times[-1]))
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, last))
        s, omega = time - self.times[k], self.pendulum.omega
        slope, grow, decay = (column[k] for column in self._pieces)
        return self.zmp[k, 0] + slope * s, slope, grow * math.exp(omega * s), decay * math.exp(-omega * s)

    @property
    def duration(self) -> float:
        """Duration in s."""
        return float(self.times[-1] - self.times[0])

    def zmp_at(self, t: float) -> np.ndarray:
        """Zero moment point (2,), m; where it jumps, that of the later piece. Times are clipped."""
        return self._at(t)[0]

    def com(self, t: float) -> np.ndarray:
        """Centre of mass (2,), m."""
        zmp, _, up, down = self._at(t)
        return zmp + up + down

    def velocity(self, t: float) -> np.ndarray:
        """Its velocity (2,), m/s."""
        _, slope, up, down = self._at(t)
        return slope + self.pendulum.omega * (up - down)

    def acceleration(self, t: float) -> np.ndarray:
        """Its acceleration (2,), m/s^2."""
        _, _, up, down = self._at(t)
        return self.pendulum.omega**2 * (up + down)

    def dcm(self, t: float) -> np.ndarray:
        """Divergent component of motion (2,), m."""
        return self.pendulum.capture_point(self.com(t), self.velocity(t))


def first_zmp_for(
    pendulum: Pendulum, times: np.ndarray, zmp: np.ndarray, dcm_start: np.ndarray
) -> np.ndarray:
    """ZMP (2,) at the start for which xi(0) is ``dcm_start`` (2,), captured at the end; ``zmp`` (n, 2, 2).

    xi(0) is affine in it, so one division replaces a search. To start at rest at c, set xi(0) = c.
    """
    starts = []
    for value in (0.0, 1.0):
        trial = np.array(zmp, dtype=float)
        trial[0, 0] = value
        motion = PendulumMotion(
            pendulum=pendulum, times=times, zmp=trial, com_start=np.zeros(2), dcm_end=trial[-1, 1]
        )
        starts.append(motion.dcm(times[0]))
    return np.asarray((np.asarray(dcm_start) - starts[0]) / (starts[1] - starts[0]))


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

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.times[-1])

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
    shared: list[np.ndarray | None] = []  # middle (2,) of the feet that two consecutive supports share
    for support, other in pairwise(plan.supports):
        feet = {name: foot for name, foot in support.feet.items() if name in other.feet}
        vertices = support_vertices(robot, replace(support, feet=feet)) if feet else None
        shared.append(None if vertices is None else vertices.mean(axis=0))
    for i, support in enumerate(plan.supports):
        before = shared[i - 1] if i else None
        first = middles[i] if before is None else before
        if i < len(shared):
            zmp.append([first, middles[i] if shared[i] is None else shared[i]])
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


def distance_outside(point: np.ndarray, vertices: np.ndarray) -> float:
    """Approximate distance (m) of a point (2,) from the convex hull of ``vertices`` (n, 2); 0 inside.

    Non-negative least squares over the vertices' weights, which holds for points and segments too.
    """
    from scipy.optimize import nnls  # takes a quarter of a second to load

    centred = np.vstack([(vertices - point).T, np.ones(len(vertices))])
    return float(nnls(centred, np.array([0.0, 0.0, 1.0]))[1])
