"""Smooth distances between capsules and obstacles as CasADi expressions: one convex minimum each.

Every distance here is the least value, over the points s (and t) in [0, 1] of one or two axes, of a convex
function with a small strictly convex part added, so that the nearest points are unique and move
continuously: where links lie parallel to a face or to each other the exact distance has a kink, this one does
not. The added part is at most ``smoothing`` m and is subtracted in full. So with the true distance d, the
smooth one e and a margin m:

    e >= m  implies  d >= m            e errs on the safe side
    d >= m + sqrt(3) smoothing  implies  e >= m      (smoothing alone for capsules and spheres)

e is once continuously differentiable with bounded second derivatives; CasADi's are exact, for the nearest
points are explicit functions of the configuration. Inside an obstacle e is negative and still points
outwards; two axes that cross, or the exact middle of a box, are ridges from which every way leads out.

Nearest points of segments: Ericson, "Real-Time Collision Detection", 2005, section 5.1.9, here for the
strictly convex function, where the same clamping is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

# Bisection narrows the point down to this fraction of an axis' half length, 2^-10; Newton's steps square it.
BISECTIONS = 10
NEWTON_STEPS = 2
# A point along an axis is rounded to this fraction of its length, 2^-40.
GRAIN = 2.0**-40
# Two axes that cross: keeps the root differentiable, a millionth of the sum of the radii.
CROSSING = 1e-6


@dataclass(frozen=True)
class SymbolicAxis:
    """A segment between ``start`` and ``end`` (3,), world, m, as expressions."""

    start: ca.SX
    end: ca.SX


def segment_distance(first: SymbolicAxis, second: SymbolicAxis, reach: ca.SX, smoothing: float) -> ca.SX:
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


def box_distance(axis: SymbolicAxis, box: Box, reach: ca.SX, smoothing: float) -> ca.SX:
    """Distance of an axis from a box minus ``reach`` (radius and margin, m, > 0), at most that; smooth.

    The minimum over s of f = rounded(P(s)) + 4 k (s - 1/2)^2, minus k, with k the smoothing (see `_rounded`).
    The minimiser s is found first and held as a number; differentiated is the minimum of the parabola of f
    there, f - f_s^2 / (2 f_ss). As f_s vanishes that is f itself, its gradient f_x, and its second derivative
    f_xx - f_xs f_sx / f_ss: that of the minimum, without a derivative of the search.
    """
    start = ca.mtimes(box.rotation.T, axis.start - box.position)
    along = ca.mtimes(box.rotation.T, axis.end - axis.start)

    def profile(s: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        value, slope, curvature = _rounded(start + s * along, along, box.half_sides, reach)
        bend = 4 * smoothing
        return value + bend * (s - 0.5) ** 2, slope + 2 * bend * (s - 0.5), curvature + 2 * bend

    s, half = ca.SX(0.5), 0.5
    for _ in range(BISECTIONS):
        half /= 2
        s = s - half * ca.sign(profile(s)[1])
    # At the kink in the middle of the box Newton's step would leave the interval that bisection found.
    for _ in range(NEWTON_STEPS):
        _, slope, curvature = profile(s)
        step = slope / curvature
        s = _clamped(s - ca.fmin(ca.fmax(step, -2 * half), 2 * half))
    s = _held(s)
    value, slope, curvature = profile(s)
    settled = ca.logic_and(ca.logic_and(s > 0, s < 1), ca.fabs(step) < 2 * half)
    least = value - ca.if_else(settled, slope**2 / (2 * _held(curvature)), 0)
    return least - smoothing - reach


@dataclass(frozen=True)
class Box:
    """A box: ``rotation`` (3, 3) from its axes to the world's, ``position`` and ``half_sides`` (3,) m."""

    rotation: ca.SX
    position: ca.SX
    half_sides: ca.SX


def _rounded(point: ca.SX, along: ca.SX, half_sides: ca.SX, radius: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The d for which ``point`` lies on the box with half sides h + d, its edges rounded by ``radius``.

    And its first and second derivative when the point moves at the constant rate ``along``.

    With y = |x| - h, r the radius and w_j = max(0, y_j + r - d): sum_j w_j^2 = r^2, hence d' = sum w y' /
    sum w and d'' = sum (y' - d')^2 / sum w over the faces with w > 0. Convex, equal to the distance from
    the box where that is r, and its gradient never vanishes: the components w / sum w add up to 1.
    Beyond r it is at least r + (distance - r) / sqrt(3), and at most the distance.
    """
    sides = [ca.if_else(point[i] >= 0, 1, -1) for i in range(3)]
    y = [sides[i] * point[i] - half_sides[i] for i in range(3)]
    rates = [sides[i] * along[i] for i in range(3)]
    d = _level(y, radius)
    w = [ca.fmax(0, entry + radius - d) for entry in y]
    total = w[0] + w[1] + w[2]
    slope = (w[0] * rates[0] + w[1] * rates[1] + w[2] * rates[2]) / total
    bends = [ca.if_else(w[i] > 0, (rates[i] - slope) ** 2, 0) for i in range(3)]
    return d, slope, (bends[0] + bends[1] + bends[2]) / total


def _level(y: list[ca.SX], r: ca.SX) -> ca.SX:
    """The d with sum_j max(0, y_j + r - d)^2 = r^2: a root for one, two or three faces."""
    top, low = ca.fmax(ca.fmax(y[0], y[1]), y[2]), ca.fmin(ca.fmin(y[0], y[1]), y[2])
    mid = y[0] + y[1] + y[2] - top - low
    # Where a root applies, its radicand is at least r^2.
    two = r + (top + mid - ca.sqrt(ca.fmax(2 * r**2 - (top - mid) ** 2, r**2))) / 2
    spread = (top - mid) ** 2 + (mid - low) ** 2 + (top - low) ** 2
    three = r + (top + mid + low - ca.sqrt(ca.fmax(3 * r**2 - spread, r**2))) / 3
    return ca.if_else(mid + r > top, ca.if_else(low + r > two, three, two), top)


def _clamped(s: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(s, 0), 1)


def _held(value: ca.SX) -> ca.SX:
    """The value as a number without derivative: rounded down to a multiple of `GRAIN`."""
    return GRAIN * ca.floor(value / GRAIN)
