"""Recovery steps: where a robot stands and its capture point leaves its feet, they step below it.

An inverted pendulum comes to rest over the capture point xi = c + dc / w, w = sqrt(g / h) (Pratt et al.,
Humanoids 2006): dxi = w (xi - p) with the centre of pressure p. Feet that stand hold it where they can put p
beyond it; else groups of feet (diagonal pairs of four, single soles of two) swing in turn until they can.
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.control.footholds import FootholdOffsets
from trajopt.control.plan_targets import PlanTargets
from trajopt.control.reference import ReferenceTrajectory
from trajopt.control.robot_state import RobotState
from trajopt.dynamics.base_joint import position_limits
from trajopt.control.support_polygon import SupportPolygon
from trajopt.solution.solution import Solution

# A swing lasts so many natural times and lifts feet by this part of l.
SWING, LIFT = 0.5, 0.07
# Steps begin where the capture point is less than the first, and end where it is more than the second part of
# l inside the edge of the feet.
LEAVES, RETURNS = 0.02, 0.05
# Feet stand where they should relative to each other if they are off by less than this part of l.
APART = 0.05
# A swinging foot that touches after this part of its swing stands.
LANDS = 0.6
# A foot that is late is pressed down with this part of sqrt(g l), by at most this part of l.
PRESSED, DEEPEST = 0.1, 0.1
# Part of the friction that the centre of mass may be braked with: the rest is for turning.
BRAKING = 0.9
# The centre of pressure is this much farther from the middle of the feet than the capture point.
STEPPING = 1.0
# Predicted growth is at most exp of this.
MOST_GROWTH = 2.0
# Feet land this far towards the capture point: beyond one they turn the robot back.
BEYOND = 1.1
UPRIGHT, RISING, CROUCH = 4.0, 0.3, 0.06
STRETCH, OVER = 0.93, 0.98
AGAIN = 0.2
LOST = 0.05
LOWEST = 0.1


@dataclass(frozen=True, kw_only=True)
class FootPath:
    """What a swinging foot follows at a tick: position, velocity, acceleration (3,), world."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, kw_only=True)
class RecoveryStep:
    """What recovery asks of a tick.

    active: feet (nc,) that transmit forces. acceleration: (3,) of the centre of mass, m/s^2. swings: of feet.
    """

    active: np.ndarray
    acceleration: np.ndarray
    swings: dict[int, FootPath]


class Recovery:
    """Steps of one robot, a state machine: off; stepping, a group of feet at a time; standing."""

    def __init__(
        self,
        plan: Solution,
        reference: ReferenceTrajectory,
        targets: PlanTargets,
        frames: list[int],
        *,
        level: np.ndarray,
        length: float,
        gravity: float,
        body: float,
    ) -> None:
        self._targets, self._frames = targets, frames
        self._length, self._gravity, self._time = length, gravity, float(np.sqrt(length / gravity))
        self._body = body / self._time
        self._first = _last_stance(plan, reference, level)
        self.groups: tuple[tuple[int, ...], ...] = ()
        if self._first < len(reference.t):
            self.groups = groups_of(plan, reference.active[-1], targets.position[-1])
        self._offsets = FootholdOffsets(
            len(frames), period=reference.period, length=length, time=self._time
        )
        self._hips = [hip_of(plan.model, frame) for frame in frames] if self.groups else []
        self._reach = [reach_of(plan.model, frame) for frame in frames] if self.groups else []
        self._touched_at = np.full(len(frames), -np.inf)
        self._landed = np.ones(len(frames), dtype=bool)
        self._swinging: tuple[int, ...] = ()
        self._since = 0.0
        self.engaged = False

    def copy(self) -> Recovery:
        """This state, apart."""
        own = copy.copy(self)
        own._offsets, own._landed = self._offsets.copy(), self._landed.copy()
        return own

    def step(self, k: int, t: float, state: RobotState, touching: np.ndarray) -> RecoveryStep | None:
        """Go on by one tick; None while the plan is followed as it is."""
        if not self.groups or k < self._first:
            return None
        self._touched_at = np.where(touching, t, self._touched_at)
        places = np.array([state.frame(frame).placement.translation for frame in self._frames])
        com, change = state.centre_of_mass()[:2]
        feet = [i for group in self.groups for i in group]
        height = max(float(com[2] - places[feet, 2].mean()), LOWEST * self._length)
        rate = float(np.sqrt(self._gravity / height))
        capture = (com + change / rate)[:2]
        if not self.engaged:
            whole = SupportPolygon(places[feet])
            if whole.outside(capture) < -LEAVES * self._length:
                return None
            self.engaged = True
        self._advance(k, t, places, touching, capture)
        active = self._landed & (t - self._touched_at <= LOST * self._time)
        active &= np.isin(np.arange(len(active)), feet)
        hips = np.array([state.data.oMi[hip].translation for hip in self._hips])
        active &= np.linalg.norm(places - hips, axis=1) < OVER * np.array(self._reach)
        pressure = self._pressure(k, places, active, com, change, rate)
        return RecoveryStep(
            active=active,
            acceleration=self._acceleration(k, com, change, rate, pressure),
            swings=self._paths(k, t, com, change, rate, pressure, places, active, hips),
        )

    def _middle(self, k: int, places: np.ndarray, feet: list[int]) -> np.ndarray:
        """Where the centre of mass is over feet as in the plan (2,)."""
        targets = self._targets
        return np.asarray(
            targets.com[k, 0, :2] + (places[feet] - targets.position[k, feet])[:, :2].mean(axis=0)
        )

    def _advance(
        self, k: int, t: float, places: np.ndarray, touching: np.ndarray, capture: np.ndarray
    ) -> None:
        """Feet land, and groups begin to swing."""
        feet = [i for group in self.groups for i in group]
        if self._swinging:
            done = (t - self._since) / (SWING * self._time)
            for i in self._swinging:
                if touching[i] and done > LANDS:
                    self._landed[i] = True
        if not self._landed[feet].all():
            return
        whole = SupportPolygon(places[feet])
        margin = -whole.outside(capture) / self._length
        if not self._swinging:
            if margin < LEAVES:
                self._swing(t, min(self.groups, key=lambda group: self._left(places, group, capture)))
            return
        offsets = (places[feet] - self._targets.position[k, feet])[:, :2]
        apart = np.abs(offsets - offsets.mean(axis=0)).max() / self._length
        if margin > RETURNS and apart < APART:
            self._swinging = ()
            return
        self._swing(t, next(group for group in self.groups if group != self._swinging))

    def _left(self, places: np.ndarray, group: tuple[int, ...], capture: np.ndarray) -> float:
        """How far the capture point is outside of the other feet."""
        rest = [i for other in self.groups if other != group for i in other]
        return SupportPolygon(places[rest]).outside(capture)

    def _swing(self, t: float, group: tuple[int, ...]) -> None:
        self._swinging, self._since = group, t
        self._landed[list(group)] = False

    def _pressure(
        self, k: int, places: np.ndarray, active: np.ndarray, com: np.ndarray, change: np.ndarray, rate: float
    ) -> np.ndarray:
        """Wanted centre of pressure (2,) within the feet that stand; below the centre of mass in flight."""
        own = np.flatnonzero(active)
        if not len(own):
            return np.array(com[:2])
        middle = self._middle(k, places, list(own))
        capture = (com + change / rate)[:2]
        wanted = capture + STEPPING * (capture - middle)
        return SupportPolygon(places[own]).nearest(wanted)

    def _acceleration(
        self, k: int, com: np.ndarray, change: np.ndarray, rate: float, pressure: np.ndarray
    ) -> np.ndarray:
        level = rate**2 * (com[:2] - pressure)
        i = self.groups[0][0]
        most = BRAKING * float(self._targets.surfaces.friction[k, i]) * self._gravity
        level = level * min(1.0, most / max(float(np.linalg.norm(level)), most))
        wanted, speed, _ = self._targets.com[k]
        up = self._targets.com[k, 2, 2]
        stiff = UPRIGHT / self._time
        up += -2 * stiff * (change[2] - speed[2]) - stiff**2 * (com[2] + CROUCH * self._length * bool(self._swinging) - wanted[2])
        up = min(max(up, -RISING * self._gravity), RISING * self._gravity)
        return np.array([*level, up])

    def _paths(
        self,
        k: int,
        t: float,
        com: np.ndarray,
        change: np.ndarray,
        rate: float,
        pressure: np.ndarray,
        places: np.ndarray,
        active: np.ndarray,
        hips: np.ndarray,
    ) -> dict[int, FootPath]:
        targets, found = self._targets, {}
        duration = SWING * self._time
        done = (t - self._since) / duration
        left = max((1.0 - done) * duration, 0.0)
        growth = min(left * rate, MOST_GROWTH)
        if active.any():
            then = pressure + (com[:2] - pressure) * np.cosh(growth) + change[:2] / rate * np.sinh(growth)
            capture = pressure + ((com + change / rate)[:2] - pressure) * np.exp(growth)
        else:
            then = com[:2] + change[:2] * left
            capture = then + change[:2] / rate
        error = np.zeros(3)
        error[:2] = then - targets.com[k, 0, :2]
        wanted = then + BEYOND * (capture - then) - targets.com[k, 0, :2]
        for group in self.groups:
            for i in group:
                nominal = targets.position[k, i]
                if active[i]:
                    self._offsets.stand(i, (places[i] - nominal)[:2])
                    continue
                beside = np.zeros(3)
                hip = hips[i, :2] + then - com[:2]
                high = float(hips[i, 2] - nominal[2])
                most = np.sqrt(max((STRETCH * self._reach[i]) ** 2 - high**2, 0.0))
                step = nominal[:2] + wanted - hip
                step = step * min(1.0, most / max(float(np.linalg.norm(step)), most))
                beside[:2] = hip + step - nominal[:2]
                change_of = self._offsets.swing(i, error, beside, AGAIN * self._time if self._landed[i] else left)
                height, speed, lift = self._height(1.0 if self._landed[i] else done)
                found[i] = FootPath(
                    position=nominal + np.array([*self._offsets.offset[i], height]),
                    velocity=np.array([*self._offsets.rate[i], speed]),
                    acceleration=np.array([*change_of, lift]),
                )
        return found

    def _height(self, done: float) -> tuple[float, float, float]:
        """Height over the ground of a foot after a part of its swing, with its rates."""
        high, duration = LIFT * self._length, SWING * self._time
        if done >= 1:
            speed = PRESSED * float(np.sqrt(self._gravity * self._length))
            return -min(speed * (done - 1) * duration, DEEPEST * self._length), -speed, 0.0
        height = 16 * high * done**2 * (1 - done) ** 2
        speed = 32 * high * done * (1 - done) * (1 - 2 * done) / duration
        return height, speed, 32 * high * (1 - 6 * done + 6 * done**2) / duration**2


def hip_of(model: pin.Model, frame: int) -> int:
    """The first joint between the base and a frame."""
    return int(list(model.supports[model.frames[frame].parentJoint])[2])


def reach_of(model: pin.Model, frame: int) -> float:
    """Largest distance of a frame from its hip within the ranges of the joints between, m."""
    joints = list(model.supports[model.frames[frame].parentJoint])[2:]
    lower, upper = position_limits(model)
    data, most = model.createData(), 0.0
    ranges = []
    for joint in joints[1:]:
        row = model.joints[joint].idx_q
        ranges.append(np.linspace(max(lower[row], -np.pi), min(upper[row], np.pi), 9))
    for angles in itertools.product(*ranges):
        q = pin.neutral(model)
        for joint, angle in zip(joints[1:], angles, strict=True):
            q[model.joints[joint].idx_q] = angle
        pin.framesForwardKinematics(model, data, q)
        most = max(most, float(np.linalg.norm(data.oMf[frame].translation - data.oMi[joints[0]].translation)))
    return most


def groups_of(plan: Solution, standing: np.ndarray, places: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """Feet that swing together: diagonal pairs of four points, each of two soles; else none."""
    feet = np.flatnonzero(standing)
    kinds = {plan.meta["contact_kinds"][i] for i in feet}
    if len(feet) == 4 and "surface" not in kinds:
        from_middle = places[feet, :2] - places[feet, :2].mean(axis=0)
        around = feet[np.argsort(np.arctan2(from_middle[:, 1], from_middle[:, 0]))]
        return (int(around[0]), int(around[2])), (int(around[1]), int(around[3]))
    return ()


def _last_stance(plan: Solution, reference: ReferenceTrajectory, level: np.ndarray) -> int:
    """First tick of a stance that lasts to the end, where the plan rests; as many as ticks if none."""
    n, active = len(reference.t), reference.active
    if plan.meta.get("periodicity") or not reference.held or not active[-1].any():
        return n
    if not level[-1][active[-1]].all():
        return n
    changes = np.flatnonzero((active != active[-1]).any(axis=1))
    return int(changes[-1]) + 1 if len(changes) else 0
