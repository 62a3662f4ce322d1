"""Where feet land beside their planned footholds, so that the next stance catches the centre of mass."""

from __future__ import annotations

import copy

import numpy as np

from trajopt.control.support import Support

# A foot in the air takes at least this part of the natural time to a new foothold.
QUICKEST = 0.15
# Errors grow by at most exp of this until touchdown: the prediction is linear.
MOST_GROWTH = 2.0
# A foot lands at most this part of l beside the foothold that moves with the centre of mass.
LONGEST = 0.25
# For an error that stays feet land at most this part of l farther.
STEADIEST = 0.1
# It stays where the velocity of the centre of mass is so close to the plan's, in sqrt(g l): not after a push.
STAYING = 0.1


def capture_error(
    error: np.ndarray, change: np.ndarray, support: Support | None, left: float, rate: float
) -> np.ndarray:
    """Error (3,) of the capture point at touchdown, m.

    The capture point of an inverted pendulum is xi = c + dc / w, w = sqrt(g / h) (Pratt et al., Humanoids
    2006). Its difference from the planned one moves by d xi = w (xi - e_p) over a support that is e_p off the
    plan, in directions in which that has no extent (Englsberger, Ott and Albu-Schaeffer, T-RO 31, 2015); in
    others the tracker's feedback holds it. In flight the centre of mass is thrown.

    Args:
        error: of the centre of mass (3,), m.
        change: of its velocity (3,), m/s.
        support: under it, None in flight.
        left: time until touchdown, s.
        rate: of the pendulum over the next support, 1/s; taken where there is no support now.
    """
    if support is None:
        return np.asarray(error + change * (left + 1.0 / rate))
    capture = error + change / support.rate
    growth = np.expm1(min(left * support.rate, MOST_GROWTH))
    return np.asarray(capture + support.axes.T @ (support.axes @ (capture - support.offset)) * growth)


class FootholdOffsets:
    """Offsets (2,) of feet from their planned motions, m, and their rates.

    A foot that stands is where it was measured. In the air its offset goes to that of its new foothold by the
    cubic of least acceleration that arrives there at rest at touchdown, planned anew at each tick.

    Args:
        n: how many feet there are.
        period: of a tick, s.
        length: of the robot, m.
        time: sqrt(l / g), s.
    """

    def __init__(self, n: int, *, period: float, length: float, time: float) -> None:
        self.offset, self.rate = np.zeros((n, 2)), np.zeros((n, 2))
        self._period, self._longest, self._least = period, LONGEST * length, QUICKEST * time

    def copy(self) -> FootholdOffsets:
        """These offsets, apart."""
        twin = object.__new__(FootholdOffsets)
        twin.__dict__ = {**self.__dict__, "offset": self.offset.copy(), "rate": self.rate.copy()}
        return twin

    def stand(self, foot: int, offset: np.ndarray) -> None:
        """A foot stands at an offset (2,)."""
        self.offset[foot], self.rate[foot] = offset, 0.0

    def swing(self, foot: int, error: np.ndarray, capture: np.ndarray, left: float) -> np.ndarray:
        """Move a foot on by one tick; returns the acceleration (2,) of its offset, m/s^2.

        Args:
            foot: its number.
            error: of the centre of mass (3,), m.
            capture: where to land beside the planned foothold (3,), m.
            left: until touchdown, s.
        """
        step = (capture - error)[:2]
        step = step * min(1.0, self._longest / max(float(np.linalg.norm(step)), self._longest))
        left = max(left, self._least)
        change = 6 * (error[:2] + step - self.offset[foot]) / left**2 - 4 * self.rate[foot] / left
        self.rate[foot] += change * self._period
        self.offset[foot] += self.rate[foot] * self._period
        return np.asarray(change)


class SteadyError:
    """What stays of the error of the centre of mass in a gait, integrated.

    Where the model's is not the robot's, or the ground is higher, feet have to land beside their footholds
    all the time. While the velocity is off the plan too, as after a push, nothing is integrated.

    Args:
        rate: of the integral, 1/s.
        period: of a tick, s.
        length: of the robot, m.
        time: sqrt(l / g), s.
    """

    def __init__(self, *, rate: float, period: float, length: float, time: float) -> None:
        self.integral = np.zeros(3)
        self._step, self._most, self._slow = rate * period, STEADIEST * length, STAYING * length / time

    def copy(self) -> SteadyError:
        """This integral, apart; updates replace its array."""
        return copy.copy(self)

    def update(self, error: np.ndarray, change: np.ndarray) -> None:
        """Integrate the error of the centre of mass (3,), m, while that of its velocity, m/s, is small."""
        if np.linalg.norm(change[:2]) < self._slow:
            self.integral = np.clip(self.integral + self._step * error, -self._most, self._most)
