"""Swing profiles, and guesses of swings over edges: up before the first, down behind the last."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType

import numpy as np

from trajopt.arguments import NonNegative, checked
from trajopt.pickling import picklable
from trajopt.terrain.crossing import Crossing, Edge, crossing
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Terrain

# Fractions of the swing time at which the foot has reached the top and at which it begins to descend.
RISE_END, DESCENT_START = 0.35, 0.65
# Fraction of the way to an edge that the guess covers before it reaches the height of the top.
BEFORE_EDGE = 0.8
# Height of the guess's arc in clearances: it is above the clearance from RISE_END to DESCENT_START.
OVER_CLEARANCE = 1.5
# Number of swings whose ground is cached.
CACHED_SWINGS = 1024

SwingPath = Callable[[str, np.ndarray, np.ndarray, float], np.ndarray]


def swing_profile(s: float) -> float:
    """16 s^2 (1 - s)^2 at the fraction ``s`` of a swing: one in mid swing, zero and flat at its ends.

    It is flat because a foot begins and ends its swing at rest. With a finite slope there, as of 4 s (1 - s),
    the height at the first node after lift-off would be proportional to the step and the acceleration needed
    inversely proportional to it, so the optimum would have no limit as the mesh is refined.
    """
    return 16.0 * s * s * (1.0 - s) ** 2


def smooth_step(s: float) -> float:
    """Step from 0 to 1 with zero rate and acceleration at both ends: 10 s^3 - 15 s^4 + 6 s^5, clipped."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)


# Inverse of the smooth step, as a table.
STEP_TIMES = np.linspace(0.0, 1.0, 201)
STEP_VALUES = np.array([smooth_step(float(time)) for time in STEP_TIMES])


@checked
def swing_path(
    terrain: Terrain,
    clearance: NonNegative,
    reach: float = 0.0,
    radii: Mapping[str, float] = MappingProxyType({}),
) -> SwingPath:
    """Path of a swinging foot over terrain, for `legged_guess`.

    The foot rises to the height of the highest ground between its ends before it gets there, and descends
    behind it. An arc is added on every kind of ground.

    Args:
        terrain: the ground.
        clearance: swing clearance, m; the arc is `OVER_CLEARANCE` times as high.
        reach: how far the foot extends ahead of and behind its position, m: half a sole's length.
        radii: radii of contacts by name, m; positions are those of their centres.

    Returns:
        (name, start (3,), end (3,), s) -> position (3,), m, world, with s from 0 to 1.

    Raises:
        InputError: for a clearance that is negative or not finite.
    """
    return _SwingPath(terrain=terrain, clearance=clearance, reach=reach, radii=radii)


@picklable
@dataclass(frozen=True, kw_only=True, eq=False)
class _SwingPath:
    terrain: Terrain
    clearance: float
    reach: float
    radii: Mapping[str, float]

    def __call__(self, name: str, start: np.ndarray, end: np.ndarray, s: float) -> np.ndarray:
        radius, ends = self.radii.get(name, 0.0), (np.asarray(start), np.asarray(end))
        ground = self._between(tuple(map(float, start)), tuple(map(float, end)), radius)
        return _over(self._raised[radius], ground, ends, min(max(s, 0.0), 1.0), self.clearance)

    @cached_property
    def _raised(self) -> dict[float, Terrain]:
        return {radius: self.terrain.offset(radius) for radius in {0.0, *self.radii.values()}}

    @cached_property
    def _between(self) -> Callable[[tuple[float, ...], tuple[float, ...], float], Crossing]:
        @lru_cache(maxsize=CACHED_SWINGS)
        def between(start: tuple[float, ...], end: tuple[float, ...], radius: float) -> Crossing:
            ends = np.array(start), np.array(end)
            ground = crossing_of(self.terrain, *ends).offset(radius, *ends)
            return _reached(ground, start, end, self.reach)

        return between


def crossing_of(terrain: Terrain, start: np.ndarray, end: np.ndarray) -> Crossing:
    """The ground between two positions (3,) m; only the planes under them on ground without edges."""
    planes = [_plane(terrain, point) for point in (start, end)]
    if isinstance(terrain, PiecewiseTerrain):
        return crossing(terrain, start, end, *planes)
    return Crossing(first=planes[0], last=planes[1])


def _reached(ground: Crossing, start: tuple[float, ...], end: tuple[float, ...], reach: float) -> Crossing:
    """The same ground with edges met where the front or back of the foot, ``reach`` m away, meets them."""
    earlier = reach / math.hypot(end[0] - start[0], end[1] - start[1]) if ground.rise or ground.fall else 0.0
    rise, fall = (edge and edge.met_earlier(earlier) for edge in (ground.rise, ground.fall))
    return replace(ground, rise=rise, fall=fall)


def _plane(terrain: Terrain, point: np.ndarray) -> Surface:
    """Plane under a position; over a hole, a level plane at the position's height."""
    if isinstance(terrain, PiecewiseTerrain) and terrain.face_at(float(point[0]), float(point[1])) is None:
        return Surface(point=point, normal=np.array([0.0, 0.0, 1.0]))
    return terrain.surface_at(point).plane_at(point)


def kept_outside(
    ground: Crossing, position: np.ndarray, s: float, ends: tuple[np.ndarray, np.ndarray], clearance: float
) -> np.ndarray:
    """The position (3,) m on another path between the same ``ends``, moved out of the obstacle on the way.

    Until `RISE_END` it stays before the edge where the obstacle begins, after `DESCENT_START` behind the one
    where it ends; in between it is over the top, and sideways shifts fade. ``ground`` is raised by the
    contact's radius, and its edges include the distance to keep (`Edge.kept_from`).
    """
    if ground.top is None:
        return position
    arc = OVER_CLEARANCE * clearance * swing_profile(s)
    fade = smooth_step((s - RISE_END) / (DESCENT_START - RISE_END))
    moved = position.copy()
    moved[2] = max(moved[2], _over_top(ground.top, ends, s) + arc)
    for edge, part in ((ground.rise, 1 - fade), (ground.fall, fade)):
        if edge is not None:
            moved += part * max(-float(edge.distance(position)), 0.0) * edge.normal
    return moved


def _over_top(top: float, ends: tuple[np.ndarray, np.ndarray], s: float) -> float:
    """Height, m, of a path that is at ``top`` from `RISE_END` to `DESCENT_START`."""
    up, down = smooth_step(s / RISE_END), smooth_step((s - DESCENT_START) / (1 - DESCENT_START))
    low, high = min(ends[0][2], top), min(ends[1][2], top)
    return float(low + up * (top - low) + down * (high - top))


def _over(
    terrain: Terrain, ground: Crossing, ends: tuple[np.ndarray, np.ndarray], s: float, clearance: float
) -> np.ndarray:
    start, end = ends
    part = smooth_step(_warped(ground, s))
    position = (1 - part) * start + part * end
    if ground.top is not None:
        position[2] = _over_top(ground.top, ends, s)
    elif not isinstance(terrain, FlatGround):
        # A valley, or smooth ground: never below what is under the foot.
        position[2] = max(position[2], float(terrain.height(position[0], position[1])))
    position[2] += OVER_CLEARANCE * clearance * swing_profile(s)
    return np.asarray(position)


def _warped(ground: Crossing, s: float) -> float:
    """Time of the horizontal motion, warped so that edges are passed between RISE_END and DESCENT_START."""
    begin, end = 0.0, 1.0
    rise, fall = _time_before(ground.rise), _time_before(ground.fall)
    if rise is not None and rise < RISE_END:
        begin = (RISE_END - rise) / (1 - rise)
    if fall is not None and fall < 1 - DESCENT_START:
        end = 1 - (1 - DESCENT_START - fall) / (1 - fall)
    return (s - begin) / (end - begin)


def _time_before(edge: Edge | None) -> float | None:
    """Time at which a smooth step has covered BEFORE_EDGE of the way to an edge."""
    return None if edge is None else float(np.interp(BEFORE_EDGE * edge.part, STEP_VALUES, STEP_TIMES))
