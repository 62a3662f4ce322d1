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
from trajopt.motion.cycles import CycleImage, in_passes, passes_of
from trajopt.motion.sampled_motion import SampledMotion
from trajopt.motion.samples import contact_places
from trajopt.motion.solution import Solution
from trajopt.motion.touched import touched_surfaces

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


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceTrajectory(SampledMotion, ContactTimeline):
    """A plan at the starts of n periods of the controller.

    ``a``, ``tau`` and ``drive_torque`` are those in the middle of each period; ``a`` is the mean if a phase
    ends within it.

    Args:
        plan: what is sampled.
        end: configuration (nq,) at the end of the plan.
        shortest: duration of the shortest phase, s.
    """

    plan: Solution
    end: np.ndarray
    shortest: float

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
    passes = passes_of(plan, cycles)
    start, last = float(plan.interval_t[0, 0]), float(plan.interval_t[-1, 1])
    require_few_ticks((last - start) * rate * passes, "a lower control_rate or fewer cycles")
    count = max(1, round((last - start) * rate))
    period, number = (last - start) / count, np.repeat(np.arange(passes), count)
    once, end = _once(plan, start + period * np.arange(count), period), plan.q[-1]
    for _ in range(passes - 1):
        end = CycleImage.of(plan).of_states(end, np.zeros(plan.model.nv))[0]
    motion = in_passes(plan, once.at(np.tile(np.arange(count), passes)), number)
    reference = ReferenceTrajectory(
        **vars(replace(motion, t=motion.t + number * (last - start))),
        period=period,
        plan=plan,
        end=end,
        shortest=min(plan.phase_durations),
    )
    return _with_hold(plan, reference, hold)


def require_few_ticks(periods: float, remedy: str) -> None:
    """Raise `InputError` for a simulation of too many periods of its controller."""
    if periods > MOST_PERIODS:
        raise InputError(
            f"a simulation of {periods:.3g} periods of its controller", f"allowed: {MOST_PERIODS}; {remedy}"
        )


def _once(plan: Solution, t: np.ndarray, period: float) -> SampledMotion:
    """Samples at the starts ``t`` (n,) of periods, with accelerations and torques in their middles.

    The acceleration is the mean if a phase ends and forces jump: a contact that lifts within a period may
    carry three times the weight. Without the mean, up to half a period of its force would be gained or lost.
    What is carried changes at ticks alone: torques are then those of the phase in which a period begins.
    """
    ends = np.array([plan.t[rows.start] for rows in plan.phases[1:]])
    cuts = {
        k: np.array([t[k], *ends[(ends > t[k]) & (ends < t[k] + period)], t[k] + period])
        for k in sorted({int(np.searchsorted(t, end, side="right")) - 1 for end in ends})
    }
    inner = np.concatenate([t[:1], *(cut[:-1] + np.diff(cut) / 2 for cut in cuts.values())])
    motion, middle, parts = (plan.sample(times=times) for times in (t, t + period / 2, inner))
    a, tau, drive_torque, row = middle.a.copy(), middle.tau.copy(), middle.drive_torque.copy(), 1
    for k, cut in cuts.items():
        a[k] = np.diff(cut) @ parts.a[row : row + len(cut) - 1] / period
        if plan.description.payloads:
            tau[k], drive_torque[k] = parts.tau[row], parts.drive_torque[row]
        row += len(cut) - 1
    return replace(motion, a=a, tau=tau, drive_torque=drive_torque)


def _at_rest(plan: Solution, reference: ReferenceTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """Torques (nu,) and contact forces (nc, 6) that hold the plan's end; the forces are nearest to the last.

    A plan that has come to rest may still accelerate: its last torques would move it away again.
    """
    model, q, actuation = plan.carrying_model(int(plan.phase[-1])), plan.q[-1], plan.actuation
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
    gravity = gravity - plan.known_force(plan.t[-1], q, np.zeros(model.nv))
    sizes = [6 if contact.is_sole else 3 for contact in plan.description.contacts]
    picked = [(i, size) for i, size in enumerate(sizes) if plan.active[-1, i]]
    levers = np.zeros((len(sizes), 3))
    if plan.description.rolling.any():
        levers = touched_surfaces(plan.description, contact_places(plan).position, plan.phase).lever[-1]
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
    speed = np.abs(plan.v[-1]) * plan.units.time
    if plan.description.periodicity or speed.max(initial=0.0) > REST:
        return reference
    held, count = math.ceil(hold * plan.units.time / reference.period), len(reference.t)
    torque, force = _at_rest(plan, reference)
    longer = reference.at(np.minimum(np.arange(count + held), count - 1))
    last = {
        "q": plan.q[-1],
        "v": np.zeros(plan.model.nv),
        "a": np.zeros(plan.model.nv),
        "tau": torque,
        "drive_torque": torque,
        "f": force,
        "phase": np.array(len(reference.phase_names)),
    }
    after: dict[str, Any] = {
        name: np.concatenate([getattr(reference, name), np.repeat(value[None], held, axis=0)])
        for name, value in last.items()
    }
    t = reference.t[0] + reference.period * np.arange(count + held)
    return replace(longer, **after, t=t, phase_names=(*reference.phase_names, "hold"), held=held)
