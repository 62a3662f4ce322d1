"""The plan on the grid of the controller: motion, torques and contacts for each period."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, PositiveCount, checked
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError
from trajopt.motion.carried import carrying_model
from trajopt.motion.cycles import CycleImage, passes_of
from trajopt.motion.quantities import MotionQuantities
from trajopt.motion.solution import Solution
from trajopt.robot.natural_units import NaturalUnits

# Time for which the last posture of a plan that ends at rest is held, over sqrt(l / g), to test balance.
HOLD = 2.0
# Largest final rate in natural units at which a plan ends at rest.
REST = 1e-3
# Largest number of controller periods in a simulation: each one is sampled and recorded.
MOST_PERIODS = 200_000


@dataclass(frozen=True, kw_only=True)
class ContactTimeline:
    """Ticks of a controller, and the phase and contacts of each.

    Args:
        t: start of each tick (n,), s.
        period: duration of a tick, s.
        active: whether each contact is meant to stand (n, nc).
        phase: index (n,) into ``phase_names``.
        source: phase (n,) of the motion that is repeated; another index than ``phase`` in later cycles.
        phase_names: names of the phases.
        held: number of ticks that follow the motion, which holds its end.
    """

    t: np.ndarray
    period: float
    active: np.ndarray
    phase: np.ndarray
    source: np.ndarray
    phase_names: tuple[str, ...]
    held: int = 0

    @property
    def planned(self) -> int:
        """Number of ticks of the motion itself."""
        return len(self.t) - self.held

    @classmethod
    def of_one_phase(cls, name: str, rate: float, duration: float, active: np.ndarray) -> ContactTimeline:
        """One phase of ``duration`` s at ``rate`` Hz, with ``active`` contacts (nc,). Raises `InputError`."""
        require_few_ticks(duration * rate, "a lower control_rate or a shorter duration")
        count = max(1, round(duration * rate))
        return cls(
            t=np.arange(count) / rate,
            period=1.0 / rate,
            active=np.tile(active, (count, 1)),
            phase=np.zeros(count, dtype=int),
            source=np.zeros(count, dtype=int),
            phase_names=(name,),
        )

    def until(self, count: int) -> ContactTimeline:
        """The first ``count`` ticks."""
        rows = {name: getattr(self, name)[:count] for name in ("t", "active", "phase", "source")}
        return replace(self, **rows)


@dataclass(frozen=True, kw_only=True)
class ReferenceTrajectory(ContactTimeline):
    """A plan at the starts of n periods of the controller.

    Args:
        q: configurations (n, nq), Pinocchio's.
        v: velocities (n, nv).
        a: accelerations (n, nv) in the middle of each period; their mean if a phase ends within it.
        torque: torques of the drives (n, nu) in the middle of each period.
        f: forces (n, nc, 6) of the surroundings on active contacts.
        end: configuration (nq,) at the end of the plan.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    f: np.ndarray
    end: np.ndarray

    @property
    def modes(self) -> list[tuple[int, int]]:
        """Begin and end of the intervals of periods with constant contacts."""
        changes = np.flatnonzero((self.active[1:] != self.active[:-1]).any(axis=1)) + 1
        return list(pairwise([0, *changes.tolist(), len(self.active)]))


@checked
def reference_of(
    plan: Solution, rate: Positive, cycles: PositiveCount = 1, *, hold: NonNegative = HOLD
) -> ReferenceTrajectory:
    """Sample a plan at every tick of a controller, repeat it, and hold its end if it is at rest.

    Args:
        plan: the plan.
        rate: of the controller, Hz; rounded to a whole number of ticks in the plan.
        cycles: of a periodic plan.
        hold: how long the end is held, in natural times sqrt(l / g) with the robot's reach l.

    Raises:
        InputError: for more than one cycle of a plan that is not periodic, or for too many ticks.
    """
    whole = passes_of(plan, cycles)
    periods = float(plan.interval_t[-1, 1] - plan.interval_t[0, 0]) * rate * whole
    require_few_ticks(periods, "a lower control_rate or fewer cycles")
    one = _once(plan, rate)
    if whole > 1:
        one = _repeated(plan, one, whole)
    return _with_hold(plan, one, hold)


def require_few_ticks(periods: float, remedy: str) -> None:
    """Raise `InputError` for a simulation of too many periods of its controller."""
    if periods > MOST_PERIODS:
        raise InputError(
            f"a simulation of {periods:.3g} periods of its controller", f"allowed: {MOST_PERIODS}; {remedy}"
        )


def _once(plan: Solution, rate: float) -> ReferenceTrajectory:
    start, end = float(plan.interval_t[0, 0]), float(plan.interval_t[-1, 1])
    count = max(1, round((end - start) * rate))
    period = (end - start) / count
    t = start + period * np.arange(count)
    motion, middle = plan.sample(times=t), plan.sample(times=t + period / 2)
    return ReferenceTrajectory(
        t=t,
        period=period,
        q=motion.q,
        v=motion.v,
        a=_mean_acceleration(plan, t, period, middle.a),
        torque=middle.drive_torque,
        f=motion.f,
        active=motion.active,
        phase=motion.phase,
        source=motion.phase,
        phase_names=motion.phase_names,
        held=0,
        end=plan.q[-1].copy(),
    )


def _mean_acceleration(plan: Solution, t: np.ndarray, period: float, middle: np.ndarray) -> np.ndarray:
    """Accelerations (n, nv) in the middle of each period, or their means if a phase ends and forces jump.

    A contact that lifts within a period may carry three times the weight. Without the mean, up to half a
    period of its force would be gained or lost.
    """
    mean = middle.copy()
    ends = np.array([plan.t[rows.start] for rows in plan.phases[1:]])
    for k in {int(np.searchsorted(t, end, side="right")) - 1 for end in ends}:
        last = t[k] + period
        cuts = np.array([t[k], *ends[(ends > t[k]) & (ends < last)], last])
        parts = np.diff(cuts)
        mean[k] = parts @ plan.sample(times=cuts[:-1] + parts / 2).a / period
    return mean


def _repeated(plan: Solution, one: ReferenceTrajectory, times: int) -> ReferenceTrajectory:
    """The reference and its images in the following cycles, ``times`` in all."""
    image = CycleImage.of(plan)
    parts = [one]
    for number in range(1, times):
        last = parts[-1]
        q, v = image.of_states(last.q, last.v)
        parts.append(
            replace(
                one,
                t=one.t + number * image.duration,
                q=q,
                v=v,
                a=image.of_accelerations(last.a),
                torque=image.of_torques(last.torque),
                f=image.of_contact_forces(last.f),
                active=image.of_contacts(last.active),
                phase=one.phase + number * len(one.phase_names),
                end=image.of_states(last.end, np.zeros(plan.model.nv))[0],
            )
        )
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "q", "v", "a", "torque", "f", "active", "phase", "source")
    }
    return replace(one, **joined, phase_names=one.phase_names * times, end=parts[-1].end)


def _at_rest(plan: Solution, reference: ReferenceTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """Torques (nu,) and contact forces (nc, 6) that hold the plan's end; the forces are nearest to the last.

    A plan that has come to rest may still accelerate: its last torques would move it away again.
    """
    model, q, actuation = carrying_model(plan, int(plan.phase[-1])), plan.q[-1], plan.actuation
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
    gravity = gravity - plan.joint_force(q, np.zeros(model.nv))
    sizes = [6 if contact.is_sole else 3 for contact in plan.description.contacts]
    picked = [(i, size) for i, size in enumerate(sizes) if plan.active[-1, i]]
    levers = np.zeros((len(sizes), 3))
    if plan.description.rolling.any():
        levers = MotionQuantities(plan).surfaces.lever[-1]
    frames = [(plan.contact_frames[i], size) for i, size in picked]
    jacobian = contact_jacobian(model, q, frames, [levers[i] for i, _ in picked])
    forces = np.concatenate([np.zeros(0), *(reference.f[-1, i, :size] for i, size in picked)])
    missing = actuation.balanced(gravity - jacobian.T @ forces)
    forces += np.linalg.lstsq(actuation.balanced(jacobian).T, missing, rcond=None)[0]
    wrenches, row = np.zeros_like(reference.f[-1]), 0
    for index, size in picked:
        wrenches[index, :size] = forces[row : row + size]
        row += size
    wrenches[:, 3:] += np.cross(wrenches[:, :3], levers)
    return actuation.inputs(gravity - jacobian.T @ forces), wrenches


def _with_hold(plan: Solution, reference: ReferenceTrajectory, hold: float) -> ReferenceTrajectory:
    """The reference, with its end held for a while if the plan ends at rest."""
    units = NaturalUnits.of(plan.model)
    speed = np.abs(plan.v[-1]) * units.time
    if plan.description.periodicity or speed.max(initial=0.0) > REST:
        return reference
    held = math.ceil(hold * units.time / reference.period)
    torque, force = _at_rest(plan, reference)
    last = {
        "q": plan.q[-1],
        "v": np.zeros(plan.model.nv),
        "a": np.zeros(plan.model.nv),
        "torque": torque,
        "f": force,
        "active": reference.active[-1],
        "phase": np.array(len(reference.phase_names)),
        "source": reference.source[-1],
    }
    after: dict[str, Any] = {
        name: np.concatenate([getattr(reference, name), np.repeat(value[None], held, axis=0)])
        for name, value in last.items()
    }
    t = reference.t[0] + reference.period * np.arange(len(reference.t) + held)
    return replace(reference, **after, t=t, phase_names=(*reference.phase_names, "hold"), held=held)
