"""Path of the base through given poses: smooth while feet stand, ballistic in flight."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.problem.contact_paths import SAME_TIME
from trajopt.schedule.schedule import Schedule

# An array (3,).
Vector = Annotated[np.ndarray, ArrayShape((3,))]
# Largest turn between two waypoints while feet stand, rad: at a full turn the rate of the rotation vector is
# unbounded.
MOST_SUPPORTED_TURN = 2 * math.pi - 0.1


@checked
def hermite(
    s: float,
    duration: float,
    start: float | np.ndarray,
    start_rate: float | np.ndarray,
    end: float | np.ndarray,
    end_rate: float | np.ndarray,
) -> np.ndarray:
    """Evaluate the cubic with given values and rates at both ends, numbers or (n,), at the fraction ``s``.

    ``s`` is clipped to [0, 1]. ``duration`` is in s, rates are per s.
    """
    return _cubic(s, duration, start, start_rate, end, end_rate)


def _cubic(s: float, duration: float, start: Any, start_rate: Any, end: Any, end_rate: Any) -> np.ndarray:
    s = min(max(s, 0.0), 1.0)
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * start
        + s * (1 - s) ** 2 * duration * start_rate
        + s * s * (3 - 2 * s) * end
        + s * s * (s - 1) * duration * end_rate
    )


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class BaseWaypoint:
    """A pose through which the base passes.

    A velocity or rate of None is derived: from the ballistic motion next to a flight, zero at both ends of
    the path, and elsewhere from slopes without overshoot. Next to a flight the ballistic motion overrides
    given values.

    Args:
        time: s.
        position: (3,), m, world.
        turn: Rotation vector (3,), rad, world axes, of the rotation since the previous waypoint (for the
            first one, since the world's axes): R_i = exp(turn) R_(i-1). It counts full turns, as multiples
            of 2 pi.
        velocity: (3,), m/s, world.
        rate: Angular velocity (3,), rad/s, world.

    Raises:
        InputError: If a shape is wrong or a number is not finite.
    """

    time: float
    position: Vector
    turn: Vector | tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity: Vector | None = None
    rate: Vector | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "turn", np.array(self.turn, dtype=float))


class WaypointPath:
    """Placement of the base over time, C1: cubics while feet stand, parabolas with constant spin in flight.

    Between two waypoints R(t) = exp(theta(t)) R_(i-1). In flight theta grows along the turn at a constant
    rate; otherwise it is a cubic with the angular velocities at its ends, theta' = J_l(theta)^-1 omega.

    Args:
        schedule: Determines when the robot is in flight.
        waypoints: In time order; the first at time 0, one at each end of every flight and none within it.
        gravity: m/s^2, along -z.

    Raises:
        InputError: If times do not fit, or the base makes a full turn between waypoints while feet stand.
    """

    def __init__(
        self, schedule: Schedule, waypoints: Sequence[BaseWaypoint], gravity: float = STANDARD_GRAVITY
    ) -> None:
        self._points, self._gravity = tuple(waypoints), gravity
        self._times = np.array([point.time for point in self._points])
        tolerance = SAME_TIME * schedule.duration
        if len(self._points) < 1 or abs(self._times[0]) > tolerance or (np.diff(self._times) <= 0).any():
            raise InputError(
                f"the base's waypoints are at {self._times} s", "allowed: rising times that begin with 0"
            )
        self._flying = self._flights(schedule, tolerance)
        self._rotations = [pin.exp3(self._points[0].turn)]
        for point, flying in zip(self._points[1:], self._flying, strict=True):
            turned = float(np.linalg.norm(point.turn))
            if not flying and turned > MOST_SUPPORTED_TURN:
                raise InputError(
                    f"the base turns by {turned:g} rad up to {point.time:g} s while feet stand",
                    f"allowed: at most {MOST_SUPPORTED_TURN:.3g} rad from one waypoint to the next",
                )
            self._rotations.append(pin.exp3(point.turn) @ self._rotations[-1])
        self._velocities = self._rates_of("position")
        self._spins = self._rates_of("turn")
        # theta' = J_l(theta)^-1 omega at the end of a segment, with J_l(theta) = J_r(theta)^T.
        self._end_rates = [
            spin if flying else np.linalg.solve(pin.Jexp3(np.asarray(end.turn)).T, spin)
            for end, spin, flying in zip(self._points[1:], self._spins[1:], self._flying, strict=True)
        ]

    def _flights(self, schedule: Schedule, tolerance: float) -> list[bool]:
        """Return for each segment between waypoints whether it is a flight."""
        flying = [False] * (len(self._points) - 1)
        for begin, end in flights(schedule):
            first, last = (int(np.argmin(np.abs(self._times - t))) for t in (begin, end))
            missed = max(abs(self._times[first] - begin), abs(self._times[last] - end))
            if missed > tolerance or last != first + 1:
                raise InputError(
                    f"the base flies from {begin:g} to {end:g} s, its waypoints are at {self._times} s",
                    "allowed: a waypoint at each end of a flight and none within it",
                )
            flying[first] = True
        return flying

    def _rates_of(self, what: str) -> list[np.ndarray]:
        """Return the velocity or angular velocity (3,) at every waypoint; see `BaseWaypoint`."""
        values = np.array([getattr(point, what) for point in self._points])
        steps = values[1:] if what == "turn" else np.diff(values, axis=0)
        mean = steps / np.diff(self._times)[:, None]  # mean rates (n - 1, 3) between waypoints
        given = "rate" if what == "turn" else "velocity"
        rates = []
        for i, point in enumerate(self._points):
            stated = getattr(point, given)
            if i > 0 and self._flying[i - 1]:
                rates.append(mean[i - 1] - self._pull(what, i - 1))
            elif i < len(mean) and self._flying[i]:
                rates.append(mean[i] + self._pull(what, i))
            elif stated is not None:
                rates.append(stated)
            elif i in (0, len(mean)):
                rates.append(np.zeros(3))
            else:
                # Harmonic mean of the two slopes, or 0 if their signs differ: no new extremum (F. N. Fritsch,
                # J. Butland, SIAM J. Sci. Stat. Comput. 5, 1984, for equal steps).
                product = mean[i - 1] * mean[i]
                total = np.where(product > 0, mean[i - 1] + mean[i], 1.0)
                rates.append(np.where(product > 0, 2 * product / total, 0.0))
        return rates

    def _pull(self, what: str, stretch: int) -> np.ndarray:
        """Return the initial velocity of a flight minus its mean velocity (3,), due to gravity."""
        if what == "turn":
            return np.zeros(3)
        return np.array([0.0, 0.0, self._gravity * float(np.diff(self._times)[stretch]) / 2])

    @property
    def end(self) -> pin.SE3:
        """Placement at the last waypoint."""
        return pin.SE3(self._rotations[-1], self._points[-1].position)

    def velocity(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (3,) m/s and angular velocity (3,) rad/s, world, at waypoint ``index``."""
        return self._velocities[index].copy(), self._spins[index].copy()

    def __call__(self, t: float) -> pin.SE3:
        """Return the placement at ``t`` in s; times outside the path are clipped."""
        if not self._flying or t <= self._times[0]:
            return pin.SE3(self._rotations[0], self._points[0].position)
        i = min(int(np.searchsorted(self._times, t, side="right")), len(self._flying)) - 1
        duration = float(self._times[i + 1] - self._times[i])
        s = min(max((t - self._times[i]) / duration, 0.0), 1.0)
        first, last = self._points[i], self._points[i + 1]
        if self._flying[i]:
            lift = np.array([0.0, 0.0, self._gravity * duration**2 * s * (1 - s) / 2])
            position = (1 - s) * first.position + s * last.position + lift
            turned = s * np.asarray(last.turn)
        else:
            before, after = self._velocities[i : i + 2]
            position = _cubic(s, duration, first.position, before, last.position, after)
            turn = np.asarray(last.turn)
            turned = _cubic(s, duration, np.zeros(3), self._spins[i], turn, self._end_rates[i])
        return pin.SE3(pin.exp3(turned) @ self._rotations[i], position)


def heading_of(rotation: np.ndarray) -> float:
    """Return the angle (rad) from the world's x axis to that of a rotation, seen from above."""
    return math.atan2(rotation[1, 0], rotation[0, 0])


def turn_to_heading(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) about the vertical by the heading of ``rotation``."""
    return np.array(pin.utils.rotate("z", heading_of(rotation)))


def flights(schedule: Schedule) -> list[tuple[float, float]]:
    """Return start and end in s of every flight; consecutive phases without contacts are one flight."""
    stretches: list[tuple[float, float]] = []
    t, flew = 0.0, False
    for phase in schedule.phases:
        end = t + phase.duration
        if not phase.contacts:
            stretches = [*stretches[:-1], (stretches[-1][0], end)] if flew else [*stretches, (t, end)]
        t, flew = end, not phase.contacts
    return stretches
