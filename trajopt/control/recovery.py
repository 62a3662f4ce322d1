"""Recovery steps: when the capture point of a standing robot leaves its feet, they step below it.

The capture point xi = c + dc / w, w = sqrt(g / h) (Pratt et al., Humanoids 2006) moves by
dxi = w (xi - p) with the centre of pressure p. Standing feet can bring it back while p reaches beyond it.
Otherwise diagonal pairs of feet swing in turn until they can (Koolen et al., IJRR 31, 2012).
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.control.footholds import FootholdOffsets
from trajopt.control.measured_contacts import DEEPEST, LOST, PRESSED
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.control.support import LOWEST
from trajopt.dynamics.base_joint import position_limits
from trajopt.robot.natural_units import NaturalUnits
from trajopt.terrain.surface import UP

# Duration of a swing over sqrt(l / g) and its height over l: what joints and torques of the library's
# quadrupeds can do. Longer swings let the capture point go farther.
SWING, LIFT = 0.45, 0.03
# Distance of the capture point inside the feet, over l, at which steps end; recovery acts only while the plan
# keeps at least this distance. Steps begin when it leaves the feet: four feet brake better than two.
RETURNS = 0.03
# Largest error of the feet's places relative to each other, over l, at which steps end.
APART = 0.05
# Height over the ground, over l, at which a foot has left it.
LEFT = 0.001
# Fraction of a swing after which a touching foot stands; before, it has not left the ground yet.
LANDS = 0.6
# Time in which a foot that lost the ground moves to its place, over sqrt(l / g).
FOLLOWS = 0.2
# Distance of footholds from the centre of mass over that of the capture point: above one leads it back.
OVERSHOOT = 1.1
# Distances from the hip within which feet land, and beyond which they are lifted, over the reach of the leg:
# a stretched leg can neither brake nor keep a contact within its joint limits.
STRETCHED, TORN = 0.93, 0.98
# Rate at which the capture point returns to the middle of the feet, over the pendulum's rate.
RETURNING = 1.0
# Fraction of the friction that brakes the centre of mass: the rest is for turning.
BRAKING = 0.9
# Bandwidth of the height in 1 / sqrt(l / g), and its largest acceleration over g: feet that carry no weight
# cannot brake.
UPRIGHT, RISING = 4.0, 0.3


@dataclass(frozen=True, kw_only=True)
class FootPath:
    """Target of a foot at a tick: position, velocity and acceleration (3,), world axes, in m and s."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, kw_only=True)
class RecoveryStep:
    """Targets of recovery at a tick.

    Args:
        active: contacts that transmit forces (nc,).
        acceleration: acceleration of the centre of mass (3,), m/s^2.
        paths: paths of the feet in the air, by contact.
    """

    active: np.ndarray
    acceleration: np.ndarray
    paths: dict[int, FootPath]


class Recovery:
    """A state machine: off; stepping, one group of feet at a time; standing where the robot came to rest.

    It acts in the last stance of plans that end at rest on four point feet on level ground.

    Args:
        reference: the tracked plan at the ticks.
        targets: its targets.

    ``steps`` tells whether it ever acts.
    """

    def __init__(self, reference: ReferenceTrajectory, targets: PlanTargets) -> None:
        self._targets, self._units, self._frames = targets, reference.units, reference.contact_ids
        self._feet, self._groups = _feet_of(reference, targets)
        self.steps = bool(self._feet)
        self._legs: dict[int, SwingLeg] = {
            i: swing_leg(reference.model, self._frames[i], reference.actuated_rows) for i in self._feet
        }
        self._first = self._first_tick(reference)
        self._offsets = FootholdOffsets(
            len(self._frames), period=reference.period, length=self._units.length, time=self._units.time
        )
        self._touched_at = np.full(len(self._frames), -np.inf)
        self._landed = np.ones(len(self._frames), dtype=bool)
        self._lifted = np.zeros(len(self._frames), dtype=bool)
        self._swinging: tuple[int, ...] = ()
        self._since = 0.0
        self.engaged = False

    def copy(self) -> Recovery:
        """An independent copy of the state machine."""
        twin = copy.copy(self)
        twin._offsets = self._offsets.copy()
        twin._landed, twin._lifted = self._landed.copy(), self._lifted.copy()
        return twin

    def step(self, k: int, t: float, state: RobotState, touching: np.ndarray) -> RecoveryStep | None:
        """Advance by one tick; returns None while the plan is followed as it is.

        Args:
            k: tick of the plan.
            t: time, s, which continues after the plan.
            state: measured state.
            touching: which contacts touch (nc,).
        """
        if k < self._first:
            return None
        self._touched_at = np.where(touching, t, self._touched_at)
        places = np.array([state.frame(frame).placement.translation for frame in self._frames])
        mass, whole = self._falling(state, places), SupportPolygon(places[self._feet])
        if not self.engaged:
            if whole.outside(mass.capture) < 0 or not np.isfinite(self._touched_at[self._feet]).all():
                return None
            self.engaged = True
        self._land(k, t, places, touching)
        if self._landed[self._feet].all():
            self._change(k, t, places, mass.capture)
        hips = {i: np.array(state.data.oMi[leg.hip].translation) for i, leg in self._legs.items()}
        active = self._standing(t, places, hips)
        pressure = self._pressure(k, places, active, mass)
        return RecoveryStep(
            active=active,
            acceleration=self._acceleration(k, state, mass, pressure),
            paths=self._paths(k, t, places, active, hips, mass, pressure),
        )

    def _first_tick(self, reference: ReferenceTrajectory) -> int:
        """First tick from which all feet stand and the planned capture point stays well between them."""
        n, targets = len(reference.t), self._targets
        if not self.steps:
            return n
        feet, margin = self._feet, RETURNS * self._units.length
        for k in range(n - 1, -1, -1):
            over, places = targets.com[k], targets.position[k, feet]
            height = max(float((over[0] - places.mean(axis=0)) @ UP), LOWEST * self._units.length)
            mass = FallingMass(over[0, :2], over[1, :2], float(np.sqrt(self._units.gravity / height)))
            stands = bool((reference.active[k] == reference.active[-1]).all())
            if not stands or SupportPolygon(places).outside(mass.capture) > -margin:
                return k + 1
        return 0

    def _falling(self, state: RobotState, places: np.ndarray) -> FallingMass:
        """The centre of mass as a pendulum over the feet."""
        position, velocity = state.centre_of_mass()[:2]
        height = float((position - places[self._feet].mean(axis=0)) @ UP)
        height = max(height, LOWEST * self._units.length)
        return FallingMass(position[:2], velocity[:2], float(np.sqrt(self._units.gravity / height)))

    def _land(self, k: int, t: float, places: np.ndarray, touching: np.ndarray) -> None:
        """Find which swinging feet have left the ground, and which have landed."""
        over = (places - self._targets.position[k]) @ UP
        lands = t - self._since > LANDS * SWING * self._units.time
        for i in self._swinging:
            self._landed[i] |= touching[i] and self._lifted[i] and lands
            self._lifted[i] |= over[i] > LEFT * self._units.length

    def _change(self, k: int, t: float, places: np.ndarray, capture: np.ndarray) -> None:
        """With all feet on the ground, stand or begin the next swing."""
        inside = -SupportPolygon(places[self._feet]).outside(capture)
        beside = (places - self._targets.position[k])[self._feet, :2]
        apart = float(np.abs(beside - beside.mean(axis=0)).max())
        length = self._units.length
        if not self._swinging:
            if inside < 0:
                self._swing(t, min(self._groups, key=lambda group: self._missed(places, group, capture)))
        elif inside > RETURNS * length and apart < APART * length:
            self._swinging = ()
        else:
            self._swing(t, next(group for group in self._groups if group != self._swinging))

    def _missed(self, places: np.ndarray, group: tuple[int, ...], capture: np.ndarray) -> float:
        """Distance of the capture point outside the feet that stand while a group swings, m."""
        return SupportPolygon(places[[i for i in self._feet if i not in group]]).outside(capture)

    def _swing(self, t: float, group: tuple[int, ...]) -> None:
        self._swinging, self._since = group, t
        self._landed[list(group)] = self._lifted[list(group)] = False

    def _standing(self, t: float, places: np.ndarray, hips: dict[int, np.ndarray]) -> np.ndarray:
        """Contacts (nc,) that transmit forces: landed, touching, and within the reach of their legs."""
        standing = np.zeros(len(places), dtype=bool)
        lately = t - self._touched_at <= LOST * self._units.time
        for i, leg in self._legs.items():
            near = float(np.linalg.norm(places[i] - hips[i])) < TORN * leg.reach
            standing[i] = self._landed[i] and lately[i] and near
        return standing

    def _pressure(
        self, k: int, places: np.ndarray, active: np.ndarray, mass: FallingMass
    ) -> np.ndarray | None:
        """Centre of pressure (2,) within the standing feet that brakes the centre of mass; None in flight."""
        standing = np.flatnonzero(active)
        if not len(standing):
            return None
        beside = (places - self._targets.position[k])[standing, :2].mean(axis=0)
        middle = self._targets.com[k, 0, :2] + beside
        return SupportPolygon(places[standing]).nearest(mass.holding(middle, RETURNING))

    def _acceleration(
        self, k: int, state: RobotState, mass: FallingMass, pressure: np.ndarray | None
    ) -> np.ndarray:
        """Wanted acceleration of the centre of mass (3,), m/s^2: level within friction, soft in height."""
        gravity, stiff = self._units.gravity, UPRIGHT / self._units.time
        level = np.zeros(2) if pressure is None else mass.acceleration(pressure)
        most = BRAKING * float(self._targets.surfaces.friction[k, self._feet].min()) * gravity
        level = level * min(1.0, most / max(float(np.linalg.norm(level)), most))
        error, change = (state.centre_of_mass()[row] - self._targets.com[k, row] for row in (0, 1))
        up = float(self._targets.com[k, 2, 2] - 2 * stiff * change[2] - stiff**2 * error[2])
        return np.array([*level, min(max(up, -RISING * gravity), RISING * gravity)])

    def _paths(
        self,
        k: int,
        t: float,
        places: np.ndarray,
        active: np.ndarray,
        hips: dict[int, np.ndarray],
        mass: FallingMass,
        pressure: np.ndarray | None,
    ) -> dict[int, FootPath]:
        """Paths of the feet that do not stand, to footholds that catch the centre of mass."""
        done = (t - self._since) / (SWING * self._units.time)
        left = max(1.0 - done, 0.0) * SWING * self._units.time
        then, paths = mass.after(left, pressure), {}
        error = np.append(then.place - self._targets.com[k, 0, :2], 0.0)
        for i in self._feet:
            planned = self._targets.position[k, i]
            rises = not (self._landed[i] or self._lifted[i])  # straight up, not to drag along the ground
            if active[i] or rises:
                self._offsets.stand(i, (places[i] - planned)[:2])
            if active[i]:
                continue
            hip = hips[i] + np.append(then.place - mass.place, 0.0)
            foothold = self._foothold(i, planned + error, hip, then)
            lost = bool(self._landed[i])
            time = FOLLOWS * self._units.time if lost else left
            change = np.zeros(2) if rises else self._offsets.swing(i, error, foothold - planned, time)
            height, speed, rise = swing_height(1.0 if lost else done, self._units)
            paths[i] = FootPath(
                position=planned + np.array([*self._offsets.offset[i], height]),
                velocity=np.array([*self._offsets.rate[i], speed]),
                acceleration=np.array([*change, rise]),
            )
        return paths

    def _foothold(self, i: int, below: np.ndarray, hip: np.ndarray, then: FallingMass) -> np.ndarray:
        """Foothold (3,) that catches the body, within the leg's reach, for a foot that belongs ``below``."""
        step = below - hip
        step[:2] += OVERSHOOT * (then.capture - then.place)
        longest = max((STRETCHED * self._legs[i].reach) ** 2 - float(step[2]) ** 2, 0.0) ** 0.5
        step[:2] *= min(1.0, longest / max(float(np.linalg.norm(step[:2])), longest, 1e-9))
        return np.asarray(hip + step)


def swing_height(done: float, units: NaturalUnits) -> tuple[float, float, float]:
    """Height of a foot over the ground at a fraction s of its swing, m, with its rate and acceleration.

    It is 16 H s^2 (1 - s)^2, at rest at both ends; after the swing the foot is pressed down.
    """
    high, duration = LIFT * units.length, SWING * units.time
    if done >= 1:
        speed = PRESSED * units.length / units.time
        return -min(speed * (done - 1) * duration, DEEPEST * units.length), -speed, 0.0
    return (
        16 * high * done**2 * (1 - done) ** 2,
        32 * high * done * (1 - done) * (1 - 2 * done) / duration,
        32 * high * (1 - 6 * done + 6 * done**2) / duration**2,
    )


def _feet_of(
    reference: ReferenceTrajectory, targets: PlanTargets
) -> tuple[list[int], tuple[tuple[int, ...], ...]]:
    """Feet that step and groups that swing together; none unless the plan ends standing on four feet."""
    feet, about = np.flatnonzero(reference.active[-1]), reference.description
    points = all(not about.contacts[i].is_sole for i in feet)
    rests = reference.held and not about.periodicity
    held = targets.surfaces.bilateral[-1, feet].any() or targets.surfaces.slides[-1, feet].any()
    if len(feet) != 4 or not points or not rests or held or not targets.level[-1, feet].all():
        return [], ()
    return feet.tolist(), diagonal_pairs(feet, targets.position[-1, feet])


# Largest exponent of the pendulum's motion, which is linear.
MOST_GROWTH = 2.0


@dataclass(frozen=True)
class FallingMass:
    """A centre of mass over level ground: place (2,), m, velocity (2,), m/s, rate w = sqrt(g / h), 1/s."""

    place: np.ndarray
    velocity: np.ndarray
    rate: float

    @property
    def capture(self) -> np.ndarray:
        """The capture point (2,), c + dc / w: a centre of pressure there brings the mass to rest there."""
        return np.asarray(self.place + self.velocity / self.rate)

    def acceleration(self, pressure: np.ndarray) -> np.ndarray:
        """Acceleration w^2 (c - p) (2,) over a centre of pressure p (2,), m/s^2."""
        return np.asarray(self.rate**2 * (self.place - pressure))

    def after(self, time: float, pressure: np.ndarray | None) -> FallingMass:
        """The mass ``time`` s later, over a centre of pressure (2,), or in ballistic flight without one."""
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


# Twice the area of a triangle of corners, m^2, up to which they are on one line.
STRAIGHT = 1e-9


class SupportPolygon:
    """Convex hull of points (n, 2 or more) in the level plane; one point or a line are hulls too.

    ``corners`` (m, 2) are those of the hull, counter-clockwise.
    """

    def __init__(self, points: np.ndarray) -> None:
        places = sorted({(float(point[0]), float(point[1])) for point in points})
        lower, upper = _chain(places), _chain(places[::-1])
        self.corners = np.array(places if len(places) < 3 else lower[:-1] + upper[:-1])

    def nearest(self, point: np.ndarray) -> np.ndarray:
        """The point (2,) of the hull nearest to a point (2,)."""
        if self.outside(point) <= 0:
            return np.array(point[:2])
        feet = [_nearest_on(first, second, point) for first, second in self._edges()]
        return min(feet, key=lambda foot: math.hypot(*(foot - point[:2])))

    def outside(self, point: np.ndarray) -> float:
        """Distance of a point (2,) from the hull, m; inside, the negative distance from the nearest edge."""
        edges = self._edges()
        if len(self.corners) > 2:
            inside = min(_left_of(first, second, point) for first, second in edges)
            if inside >= 0:
                return -inside
        return min(math.hypot(*(_nearest_on(first, second, point) - point[:2])) for first, second in edges)

    def _edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return list(zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True))


def _chain(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """One side of the hull of points in lexicographic order (Andrew, Inf. Proc. Letters 9, 1979)."""
    chain: list[tuple[float, float]] = []
    for point in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= STRAIGHT:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _left_of(first: np.ndarray, second: np.ndarray, point: np.ndarray) -> float:
    """Distance of a point to the left of an edge, m."""
    return _turn(tuple(first), tuple(second), tuple(point)) / max(math.hypot(*(second - first)), 1e-12)


def _nearest_on(first: np.ndarray, second: np.ndarray, point: np.ndarray) -> np.ndarray:
    along = second - first
    length = float(along @ along)
    share = 0.0 if length == 0 else float((point[:2] - first) @ along) / length
    return np.asarray(first + min(1.0, max(0.0, share)) * along)


# Number of angles of each joint in the search for the longest leg; an odd number includes the middle.
ANGLES = 9
# Number of joints beyond the hip in the search: only the last ones of a leg with more joints move.
TRIED = 3


@dataclass(frozen=True)
class SwingLeg:
    """A leg: its hip, the first actuated joint towards its foot, and the largest distance between them, m."""

    hip: int
    reach: float


def swing_leg(model: pin.Model, frame: int, actuated_rows: np.ndarray) -> SwingLeg:
    """The leg that moves a frame of the model; the reach is found on a grid of its joints' ranges."""
    way = [
        joint
        for joint in list(model.supports[model.frames[frame].parentJoint])[1:]
        if model.joints[joint].idx_v in actuated_rows
    ]
    hip, turned = int(way[0]), way[1:][-TRIED:]
    lower, upper = position_limits(model)
    rows = [model.joints[joint].idx_q for joint in turned]
    ranges = [np.linspace(max(lower[row], -np.pi), min(upper[row], np.pi), ANGLES) for row in rows]
    data, q, longest = model.createData(), pin.neutral(model), 0.0
    for angles in itertools.product(*ranges):
        q[rows] = angles
        pin.framesForwardKinematics(model, data, q)
        longest = max(longest, float(np.linalg.norm(data.oMf[frame].translation - data.oMi[hip].translation)))
    return SwingLeg(hip, longest)


def diagonal_pairs(feet: np.ndarray, places: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """The two diagonals of four feet (4,) at places (4, 2 or more)."""
    beside = places[:, :2] - places[:, :2].mean(axis=0)
    around = feet[np.argsort(np.arctan2(beside[:, 1], beside[:, 0]))].tolist()
    return (around[0], around[2]), (around[1], around[3])
