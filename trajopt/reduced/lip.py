"""The linear inverted pendulum in closed form: motion, orbital energy, capture point.

A point mass moves at constant height z above level ground over its zero moment point (ZMP) p; for each axis

    c'' = omega^2 (c - p),     omega = sqrt(g / z)

The divergent component of motion xi = c + c' / omega (the instantaneous capture point) and the CoM obey

    xi' = omega (xi - p),      c' = -omega (c - xi)

so only xi can diverge (Kajita et al. 2001; Pratt et al. 2006; Englsberger, Ott, Albu-Schäffer 2015; Koolen
et al. 2012 for capturability). If the ZMP is linear in time, p = p0 + r s, then exactly

    c = p + grow exp(omega s) + decay exp(-omega s)

A motion is a sequence of such pieces. Horizontal vectors have 2 entries, in m.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Protocol

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape


@checked
@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """Linear inverted pendulum.

    Args:
        height: Height of the centre of mass above the ground, m.
        gravity: m/s^2.

    Raises:
        InputError: If a number is not positive.
    """

    height: Positive
    gravity: Positive = STANDARD_GRAVITY

    @property
    def omega(self) -> float:
        """Natural frequency sqrt(g / z), 1/s."""
        return math.sqrt(self.gravity / self.height)

    def after(
        self, com: np.ndarray, velocity: np.ndarray, zmp: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return CoM position and velocity (2,) after ``time`` (s, either sign) over a constant ZMP (2,)."""
        cosh, sinh = math.cosh(self.omega * time), math.sinh(self.omega * time)
        offset = np.asarray(com) - zmp
        return (
            zmp + offset * cosh + np.asarray(velocity) / self.omega * sinh,
            offset * self.omega * sinh + np.asarray(velocity) * cosh,
        )

    def capture_point(self, com: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the ZMP (2,) over which the pendulum comes to rest: c + c' / omega."""
        return np.asarray(com) + np.asarray(velocity) / self.omega

    def orbital_energy(self, com: np.ndarray, velocity: np.ndarray, zmp: np.ndarray) -> np.ndarray:
        """Return c'^2 / 2 - omega^2 (c - p)^2 / 2 for each axis (2,), J/kg; constant for a constant ZMP.

        If positive, the CoM passes over the ZMP; if negative, it turns back; if zero, it comes to rest over
        the ZMP or leaves it from rest.
        """
        return np.asarray(velocity) ** 2 / 2 - self.omega**2 * (np.asarray(com) - zmp) ** 2 / 2

    def capture_radius(self, steps: int, step_time: float, reach: float) -> float:
        """Return the largest |xi - p| in m from which ``steps`` steps bring a point-foot pendulum to rest.

        Each step takes at least ``step_time`` and is at most ``reach`` long:
        d_0 = 0, d_N = (d_(N-1) + reach) exp(-omega T) (Koolen et al. 2012, eq. 23).
        """
        radius = 0.0
        for _ in range(steps):
            radius = (radius + reach) * math.exp(-self.omega * step_time)
        return radius


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class PendulumMotion:
    """The bounded CoM motion over a piecewise linear ZMP with n pieces, from c(0) and xi(T).

    times: (n + 1,) s. zmp: (n, 2, 2) ZMP at start and end of each piece, m; it may jump between pieces.
    com_start: (2,) initial CoM, m. dcm_end: (2,) final divergent component, m.

    The divergent component is computed backwards and the CoM forwards, the stable direction of each, so that
    walks of any length are accurate. With the slope r of a piece,
    xi_k = p_k + r / omega + exp(-omega T) (xi_(k+1) - p_(k+1) - r / omega) (Englsberger et al. 2015).
    The initial velocity follows: c'(0) = omega (xi(0) - c(0)).
    """

    pendulum: Pendulum
    times: Annotated[np.ndarray, ArrayShape((None,))]
    zmp: Annotated[np.ndarray, ArrayShape((None, 2, 2))]
    com_start: Annotated[np.ndarray, ArrayShape((2,))]
    dcm_end: Annotated[np.ndarray, ArrayShape((2,))]

    def __post_init__(self) -> None:
        if len(self.times) != len(self.zmp) + 1:
            raise InputError(
                f"a pendulum's motion has {len(self.times)} times for {len(self.zmp)} pieces",
                "allowed: one more than pieces",
            )
        if not (np.diff(self.times) > 0).all():
            raise InputError(f"times of a pendulum's motion are {self.times}", "allowed: increasing")

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope of the ZMP, coefficients of the growing and the decaying exponential, (n, 2) each."""
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
        """Return the ZMP, its slope, the growing part and the decaying part at ``t``."""
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
        """Return the zero moment point (2,), m; at a jump, that of the later piece. Times are clipped."""
        return self._at(t)[0]

    def com(self, t: float) -> np.ndarray:
        """Return the position of the centre of mass (2,), m."""
        zmp, _, up, down = self._at(t)
        return zmp + up + down

    def velocity(self, t: float) -> np.ndarray:
        """Return the velocity of the centre of mass (2,), m/s."""
        _, slope, up, down = self._at(t)
        return slope + self.pendulum.omega * (up - down)

    def acceleration(self, t: float) -> np.ndarray:
        """Return the acceleration of the centre of mass (2,), m/s^2."""
        _, _, up, down = self._at(t)
        return self.pendulum.omega**2 * (up + down)

    def dcm(self, t: float) -> np.ndarray:
        """Return the divergent component of motion (2,), m."""
        return self.pendulum.capture_point(self.com(t), self.velocity(t))


class ComPath(Protocol):
    """Horizontal path of the centre of mass: a vector (2,) at a time in s, world axes."""

    def com(self, t: float) -> np.ndarray:
        """Position, m."""
        ...


class ComMotion(ComPath, Protocol):
    """A `ComPath` with its derivatives and zero moment point: vectors (2,) at a time in s, world axes."""

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
    """A CoM motion with constant jerk in each of n intervals: the pendulum with jerk input.

    times: (n + 1,) s. states: (n, 3, 2) position, velocity, acceleration at interval starts. jerk: (n, 2).
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
        """Return the position of the centre of mass (2,), m."""
        return np.asarray(self._state(t)[0])

    def velocity(self, t: float) -> np.ndarray:
        """Return the velocity of the centre of mass (2,), m/s."""
        return np.asarray(self._state(t)[1])

    def acceleration(self, t: float) -> np.ndarray:
        """Return the acceleration of the centre of mass (2,), m/s^2."""
        return np.asarray(self._state(t)[2])

    def zmp_at(self, t: float) -> np.ndarray:
        """Return the zero moment point c - c'' / omega^2, (2,), m."""
        state = self._state(t)
        return np.asarray(state[0] - state[2] / self.pendulum.omega**2)
