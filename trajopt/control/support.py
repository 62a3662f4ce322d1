"""The support of a robot: where its feet stand, how wide, and the pendulum over them."""

import math
from dataclasses import dataclass

import numpy as np

from trajopt.terrain.surface import UP

# Factors that leave the level part of a vector.
LEVEL = np.array([1.0, 1.0, 0.0])
# Least height of the pendulum over a support, over l.
LOWEST = 0.1
# Matrix of the cross product of the vertical with a vector.
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Support:
    """Standing feet, with the centre of mass as an inverted pendulum over them.

    Attributes:
        places: measured positions of the feet (n, 3), m.
        planned: planned positions of the feet (n, 3), m.
        axes: level directions (r, 3) without extent: two for a point, one for a line, none for a wide one.
        rate: sqrt(g / h) with the height h of the centre of mass over the feet, 1/s.
    """

    places: np.ndarray
    planned: np.ndarray
    axes: np.ndarray
    rate: float

    @property
    def lines(self) -> np.ndarray:
        """Directions (r, 3) of lines about which forces of the feet have no moment.

        There is one for each of ``axes``, a quarter turn to its left, whose level part has unit length. With
        feet at different heights the line slopes: about a level one the forces would have a lever.
        """
        directions = self.axes @ QUARTER_TURN.T
        if len(directions) == 1:
            apart = self.places - self.places.mean(axis=0)
            along = apart @ directions[0]
            directions[0, 2] = (along @ apart[:, 2]) / (along @ along)
        return directions

    @property
    def offset(self) -> np.ndarray:
        """Mean level offset (3,) of the feet from the plan, m."""
        return np.asarray((self.places - self.planned).mean(axis=0) * LEVEL)

    def falling(self, error: np.ndarray) -> np.ndarray:
        """Acceleration (3,) of an error of the centre of mass that the feet cannot correct, m/s^2.

        The measured and the planned pendulum obey dd c = g / h (c - p), so their difference obeys
        dd e = g / h (e - e_p).
        """
        return np.asarray(self.rate**2 * (error - self.offset))

    def reachable(self, com: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """The nearest acceleration (3,) from a centre of pressure between feet on a line, m/s^2."""
        if len(self.axes) != 1:
            return acceleration
        line = QUARTER_TURN @ self.axes[0]
        given = self.rate**2 * ((com - self.places) @ line)
        total = float(line @ acceleration)
        return np.asarray(acceleration + line * (np.clip(total, given.min(), given.max()) - total))


def support_of(
    places: np.ndarray, planned: np.ndarray, axes: np.ndarray, com: np.ndarray, gravity: float, lowest: float
) -> Support:
    """The support of a centre of mass (3,), m, taken as at least ``lowest`` m high; ``gravity`` in m/s^2."""
    height = max(float((com - places.mean(axis=0)) @ UP), lowest)
    return Support(places, planned, axes, float(np.sqrt(gravity / height)))


def thin_axes(places: np.ndarray, least: float) -> np.ndarray:
    """Level directions (r, 3) in which places (n, 3) are less than ``least`` m apart."""
    x, y = places[:, 0] - places[:, 0].mean(), places[:, 1] - places[:, 1].mean()
    # Eigenvectors of the scatter matrix in closed form, ten times as fast as NumPy's decompositions.
    along, mixed, across = float(x @ x), float(x @ y), float(y @ y)
    half, turn = (along + across) / 2, math.atan2(2 * mixed, along - across) / 2
    radius = math.hypot((along - across) / 2, mixed)
    long, short = math.sqrt(half + radius), math.sqrt(max(half - radius, 0.0))
    cosine, sine = math.cos(turn), math.sin(turn)
    axes = [((cosine, sine, 0.0), long), ((-sine, cosine, 0.0), short)]
    return np.array([axis for axis, extent in axes if extent < least]).reshape(-1, 3)


def next_narrow(active: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """Contacts (n, nc) that stand in a wide stance and will carry the narrow stance after it.

    Args:
        active: which contacts stand (n, nc).
        wide: whether these hold the body in all directions (n,).
    """
    narrow = np.zeros_like(active)
    for k in range(len(active) - 2, -1, -1):
        same = bool((active[k] == active[k + 1]).all())
        after = narrow[k + 1] if same else active[k + 1] & ~wide[k + 1]
        narrow[k] = after & bool(wide[k] and (active[k] >= after).all())
    return narrow
