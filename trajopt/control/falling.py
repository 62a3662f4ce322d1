"""A robot that falls as a linear inverted pendulum: where it goes, and what stops it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Motion grows by at most exp of this: the pendulum is linear.
MOST_GROWTH = 2.0


@dataclass(frozen=True)
class FallingMass:
    """The centre of mass over level ground: place (2,) m, velocity (2,) m/s, and w = sqrt(g / h), 1/s."""

    place: np.ndarray
    velocity: np.ndarray
    rate: float

    @property
    def capture(self) -> np.ndarray:
        """The capture point (2,), c + dc / w: with the centre of pressure there it comes to rest there."""
        return np.asarray(self.place + self.velocity / self.rate)

    def acceleration(self, pressure: np.ndarray) -> np.ndarray:
        """w^2 (c - p) (2,) over a centre of pressure (2,)."""
        return np.asarray(self.rate**2 * (self.place - pressure))

    def after(self, time: float, pressure: np.ndarray | None) -> FallingMass:
        """After some time over a centre of pressure (2,), or thrown where there is none."""
        if pressure is None:
            return FallingMass(self.place + time * self.velocity, self.velocity, self.rate)
        angle = min(self.rate * time, MOST_GROWTH)
        grown, turned, beside = np.cosh(angle), np.sinh(angle), self.place - pressure
        return FallingMass(
            pressure + grown * beside + turned / self.rate * self.velocity,
            self.rate * turned * beside + grown * self.velocity,
            self.rate,
        )

    def holding(self, middle: np.ndarray, gain: float) -> np.ndarray:
        """Centre of pressure (2,) that brings the capture point to ``middle`` (2,) at the rate gain * w."""
        return np.asarray(self.capture + gain * (self.capture - middle))
