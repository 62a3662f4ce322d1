"""Offsets of feet from their planned footholds, by which the next stance catches the centre of mass."""

from __future__ import annotations

import copy

import numpy as np

from trajopt.control.support import Support

# Shortest time in which a foot moves to a new foothold, over sqrt(l / g).
QUICKEST = 0.15
# Largest exponent by which errors grow until touchdown: the prediction is linear.
MOST_GROWTH = 2.0
# Largest offset of a foot from the foothold that moves with the centre of mass, over l.
LONGEST = 0.25
# Largest offset for a steady error, over l.
STEADIEST = 0.1
# Largest velocity error of the centre of mass, over sqrt(g l), at which an error is steady: not after a push.
STAYING = 0.1


def capture_error(
    error: np.ndarray, change: np.ndarray, support: Support | None, left: float, rate: float
) -> np.ndarray:
    """Error (3,) of the capture point at touchdown, m.

    The capture point of an inverted pendulum is xi = c + dc / w, w = sqrt(g / h) (Pratt et al., Humanoids
    2006). In directions in which the support has no extent, its difference from the planned one moves by
    d xi = w (xi - e_p), where e_p is the offset of the support from the plan (Englsberger, Ott and
    Albu-Schaeffer, T-RO 31, 2015). In the others the tracker's feedback holds it. Flight is ballistic.

    Args:
        error: error of the centre of mass (3,), m.
        change: error of its velocity (3,), m/s.
        support: the present support; None in flight.
        left: time until touchdown, s.
        rate: rate of the pendulum over the next support, 1/s, which is used in flight.
    """
    if support is None:
        return np.asarray(error + change * (left + 1.0 / rate))
    capture = error + change / support.rate
    growth = np.expm1(min(left * support.rate, MOST_GROWTH))
    return np.asarray(capture + support.axes.T @ (support.axes @ (capture - support.offset)) * growth)


class FootholdOffsets:
    """Offsets (2,) of feet from their planned motions, m, and their rates.

    A standing foot has its measured offset. In the air the offset moves to that of the new foothold along the
    cubic of least acceleration that comes to rest there at touchdown, recomputed at each tick.

    Args:
        n: number of feet.
        period: duration of a tick, s.
        length: length l of the robot, m.
        time: sqrt(l / g), s.
    """

    def __init__(self, n: int, *, period: float, length: float, time: float) -> None:
        self.offset, self.rate = np.zeros((n, 2)), np.zeros((n, 2))
        self._period, self._longest, self._least = period, LONGEST * length, QUICKEST * time

    def copy(self) -> FootholdOffsets:
        """An independent copy of the offsets."""
        twin = object.__new__(FootholdOffsets)
        twin.__dict__ = {**self.__dict__, "offset": self.offset.copy(), "rate": self.rate.copy()}
        return twin

    def stand(self, foot: int, offset: np.ndarray) -> None:
        """Set the offset (2,) of a standing foot, m."""
        self.offset[foot], self.rate[foot] = offset, 0.0

    def swing(self, foot: int, error: np.ndarray, capture: np.ndarray, left: float) -> np.ndarray:
        """Advance the offset of a foot in the air by one tick; returns its acceleration (2,), m/s^2.

        Args:
            foot: index of the foot.
            error: error of the centre of mass (3,), m.
            capture: offset at which to land from the planned foothold (3,), m.
            left: time until touchdown, s.
        """
        step = (capture - error)[:2]
        step = step * min(1.0, self._longest / max(float(np.linalg.norm(step)), self._longest))
        left = max(left, self._least)
        change = 6 * (error[:2] + step - self.offset[foot]) / left**2 - 4 * self.rate[foot] / left
        self.rate[foot] += change * self._period
        self.offset[foot] += self.rate[foot] * self._period
        return np.asarray(change)


class SteadyError:
    """The integral of the steady error of the centre of mass in a gait.

    If the model is wrong or the ground is higher, feet must always land beside their footholds. While the
    velocity is off the plan as well, as after a push, nothing is integrated.

    Args:
        rate: rate of the integral, 1/s.
        period: duration of a tick, s.
        length: length l of the robot, m.
        time: sqrt(l / g), s.
    """

    def __init__(self, *, rate: float, period: float, length: float, time: float) -> None:
        self.integral = np.zeros(3)
        self._step, self._most, self._slow = rate * period, STEADIEST * length, STAYING * length / time

    def copy(self) -> SteadyError:
        """An independent copy; updates replace the array of the integral."""
        return copy.copy(self)

    def update(self, error: np.ndarray, change: np.ndarray) -> None:
        """Integrate the error of the centre of mass (3,), m, if that of its velocity (3,), m/s, is small."""
        if np.linalg.norm(change[:2]) < self._slow:
            self.integral = np.clip(self.integral + self._step * error, -self._most, self._most)
