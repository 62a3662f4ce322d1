"""Smooth distances between capsules and obstacles as CasADi expressions: one convex minimum each.

Every distance here is the least value, over the points s (and t) in [0, 1] of one or two axes, of a convex
function with a small strictly convex part added, so that the nearest points are unique and move
continuously: where links lie parallel to a face or to each other the exact distance has a kink, this one
bends. The added part is at most ``smoothing`` m and is taken off in full. So with the true distance d,
the smooth one e and a margin m:

    e >= m  implies  d >= m            what is kept is kept truly
    d >= m + sqrt(3) smoothing  implies  e >= m      (smoothing alone for capsules and spheres)

e is once continuously differentiable with bounded second derivatives; CasADi's are exact, for the nearest
points are explicit functions of the configuration. Inside an obstacle e is negative and still points
outwards; two axes that cross, or the exact middle of a box, are ridges from which every way leads out.

Nearest points of segments: Ericson, "Real-Time Collision Detection", 2005, section 5.1.9, here for the
strictly convex function, where the same clamping is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

# Bisection leaves this part of an axis' half length, 2^-12, which one step of Newton squares.
BISECTIONS = 12
# Two axes that cross: keeps the root differentiable, a millionth of the sum of the radii.
CROSSING = 1e-6


@dataclass(frozen=True)
class Axis:
    """A segment between ``start`` and ``end`` (3,), world, m, as expressions."""

    start: ca.SX
    end: ca.SX


def segment_distance(first: Axis, second: Axis, reach: ca.SX, smoothing: float) -> ca.SX:
    """Distance of two axes minus ``reach`` (sum of radii and margin, m, > 0), at most that; smooth.

    The minimum over s, t of |P(s) - Q(t)|^2 + k ((s - 1/2)^2 + (t - 1/2)^2), k = 4 reach smoothing:
    its value exceeds the squared distance by k / 2 at most, which is 2 reach smoothing.
    """
    k = 4 * reach * smoothing
    u, w, between = first.end - first.start, second.end - second.start, first.start - second.start
    a, e, b = ca.sumsqr(u) + k, ca.sumsqr(w) + k, ca.dot(u, w)
    c, f = ca.dot(u, between) - k / 2, ca.dot(w, between) + k / 2
    s = _clamped((b * f - c * e) / (a * e - b * b))
    t = _clamped((b * s + f) / e)
    s = _clamped((b * t - c) / a)
    apart = ca.sumsqr(between + s * u - t * w) + k * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    floor = (CROSSING * reach) ** 2
    return ca.sqrt(apart + floor) - ca.sqrt(reach**2 + k / 2 + floor)


def box_distance(axis: Axis, box: Box, reach: ca.SX, smoothing: float) -> ca.SX:
    """Distance of an axis from a box minus ``reach`` (radius and margin, m, > 0), at most that; smooth.

    The minimum over s of rounded(P(s)) + 4 k (s - 1/2)^2, minus k, with k the smoothing: see `_rounded`.
    """
    start = ca.mtimes(box.rotation.T, axis.start - box.position)
    along = ca.mtimes(box.rotation.T, axis.end - axis.start)
    data = ca.vertcat(start, along, box.half_sides, reach)
    s, half = ca.SX(0.5), 0.5
    for _ in range(BISECTIONS):
        half /= 2
        s = s - half * ca.sign(_profile()(s, data, smoothing)[1])
    # Where the middle of the box makes a kink, Newton's step would leave what bisection found.
    _, slope, curvature = _profile()(s, data, smoothing)
    s = _clamped(s - ca.fmin(ca.fmax(slope / curvature, -2 * half), 2 * half))
    return _profile()(s, data, smoothing)[0] - smoothing - reach


@dataclass(frozen=True)
class Box:
    """A box: ``rotation`` (3, 3) from its axes to the world's, ``position`` and ``half_sides`` (3,) m."""

    rotation: ca.SX
    position: ca.SX
    half_sides: ca.SX


@lru_cache(maxsize=1)
def _profile() -> ca.Function:
    """(s, start, along, half sides, reach; smoothing) -> value, slope and curvature in s along an axis."""
    s, data, smoothing = ca.SX.sym("s"), ca.SX.sym("data", 10), ca.SX.sym("smoothing")
    start, along, half, reach = ca.vertsplit(data, [0, 3, 6, 9, 10])
    value = _rounded(start + s * along, half, reach) + 4 * smoothing * (s - 0.5) ** 2
    slope = ca.gradient(value, s)
    return ca.Function("profile", [s, data, smoothing], [value, slope, ca.gradient(slope, s)])


def _rounded(point: ca.SX, half_sides: ca.SX, radius: ca.SX) -> ca.SX:
    """The d for which ``point`` lies on the box with half sides h + d, edges rounded by ``radius``.

    With y = |x| - h: sum_j max(0, y_j + r - d)^2 = r^2. Convex, equal to the distance from the box where
    that is r, and nowhere without slope: of the three components of its gradient the largest is at least
    1/sqrt(3). Beyond r it is at least r + (distance - r) / sqrt(3), and at most the distance.
    """
    x, r = point, radius
    y = ca.vertcat(*[ca.if_else(x[i] >= 0, x[i], -x[i]) - half_sides[i] for i in range(3)])
    top = ca.fmax(ca.fmax(y[0], y[1]), y[2])
    low = ca.fmin(ca.fmin(y[0], y[1]), y[2])
    mid = y[0] + y[1] + y[2] - top - low
    # Roots below belong to one, two or three faces; where they apply, their squares are at least r^2.
    two = r + (top + mid - ca.sqrt(ca.fmax(2 * r**2 - (top - mid) ** 2, r**2))) / 2
    spread = (top - mid) ** 2 + (mid - low) ** 2 + (top - low) ** 2
    three = r + (top + mid + low - ca.sqrt(ca.fmax(3 * r**2 - spread, r**2))) / 3
    near_edge = ca.if_else(low + r > two, three, two)
    return ca.if_else(mid + r > top, near_edge, top)


def _clamped(s: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(s, 0), 1)
