"""A simulated motion as a solution, for replay, plots and the file format.

Phases are the planned ones, by time; the posture held after the plan is one more. A contact is active in an
interval where it carries load; in the first interval of a phase also if the plan has it active, since a file
names the surfaces of a phase by its contacts. Accelerations, torques and forces are the simulated ones at the
samples; an interval has one collocation point, at its middle.
"""

import itertools
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from trajopt.control.reference import ReferenceTrajectory
from trajopt.motion.touched import held_samples
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.figures import loaded_contacts
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.world import World
from trajopt.solution.arrays import rows_of
from trajopt.solution.description import PlanDescription
from trajopt.solution.solution import Solution
from trajopt.solution.statistics import SolveStatistics
from trajopt.versions import VERSIONED, installed_version

# Controller periods per interval: 4 ms by default, finer than a video frame.
PERIODS = 4


class MotionReport(Protocol):
    """A report on a simulated motion, as a file stores it."""

    @property
    def passed(self) -> bool:
        """Whether the motion is as required."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures."""
        ...


def simulated_solution(
    plan: Solution,
    reference: ReferenceTrajectory,
    record: SimulationRecord,
    world: World,
    report: MotionReport,
) -> Solution:
    """Convert a record to a solution of the plan's model."""
    n = len(record.feet)
    steps = round(n * reference.period / world.compiled.opt.timestep)
    chunks = _chunks(reference.phase[:n])
    rows = np.array([[first, first + (end - first) // 2, end] for first, end in chunks]).ravel()
    last = np.minimum(rows, n - 1)  # accelerations and forces are known at the starts of periods
    q = world.coordinates.from_mujoco(record.qpos)
    v = world.coordinates.rates_from_mujoco(record.qpos, record.qvel)
    a = world.coordinates.accelerations_from_mujoco(record.qpos[:n], record.qvel[:n], record.qacc)
    t = np.append(reference.t[:n], reference.t[n - 1] + reference.period)
    phase = np.array([reference.phase[first] for first, _ in chunks])
    own = plan.joint_force(q[last], v[last])  # MuJoCo's joint friction includes it
    return Solution(
        description=_description(plan, reference, phase, world),
        statistics=_statistics(plan, report, steps),
        model=plan.model,
        t=t[rows],
        phase=np.repeat(phase, 3),
        interval=np.repeat(np.arange(len(chunks)), 3),
        collocation=np.tile([False, True, False], len(chunks)),
        interval_t=t[np.array(chunks)],
        q=q[rows],
        v=v[rows],
        a=a[last],
        tau=(record.torque + record.friction)[last] - plan.actuation.inputs(own),
        f=record.force[last],
        active=np.repeat(_active(plan, reference, record, world, chunks), 3, axis=0),
        **_requests(record, last),
    )


def _requests(record: SimulationRecord, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Requests of a whole-body controller, by their names in a solution."""
    if record.requests is None:
        return {}
    asked = rows_of(record.requests, rows)
    return {"asked_force": asked.forces, "com_goal": asked.com, "foot_goal": asked.feet}


def _chunks(phase: np.ndarray) -> list[tuple[int, int]]:
    """Intervals of `PERIODS` periods, shorter at the end of a phase, as first and last row."""
    edges = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist(), len(phase)]
    return [
        (first, min(first + PERIODS, end))
        for start, end in itertools.pairwise(edges)
        for first in range(start, end, PERIODS)
    ]


def _active(
    plan: Solution,
    reference: ReferenceTrajectory,
    record: SimulationRecord,
    world: World,
    chunks: list[tuple[int, int]],
) -> np.ndarray:
    """Whether each contact is active (intervals, nc)."""
    loaded = loaded_contacts(record, world)
    held = held_samples(plan)[[rows.start for rows in plan.phases]]
    by_interval, before = [], -1
    for first, end in chunks:
        active = loaded[first:end].any(axis=0) | held[reference.source[first]]
        if reference.phase[first] != before:
            active |= reference.active[first]
        by_interval.append(active)
        before = reference.phase[first]
    return np.array(by_interval)


def _description(
    plan: Solution, reference: ReferenceTrajectory, phase: np.ndarray, world: World
) -> PlanDescription:
    """The plan's description with the simulated phases (n_chunks,): not periodic, feet rolling as here."""
    used = int(phase[-1]) + 1
    source = [int(reference.source[np.argmax(reference.phase == i)]) for i in range(used)]
    planned = plan.description
    return replace(
        planned,
        contacts=tuple(
            replace(contact, rolling=bool(rolls))
            for contact, rolls in zip(planned.contacts, world.place.rolling, strict=True)
        ),
        periodicity=None,
        phase_names=tuple(reference.phase_names[:used]),
        surfaces=tuple(planned.surfaces[i] for i in source) if planned.surfaces else (),
        patches=tuple(planned.patches[i] for i in source) if planned.patches else (),
        payloads=tuple(
            replace(body, phases=tuple(i for i, each in enumerate(source) if each in body.phases))
            for body in planned.payloads
        ),
    )


def _statistics(plan: Solution, report: MotionReport, steps: int) -> SolveStatistics:
    versions = {name: installed_version(name) for name in VERSIONED}
    return SolveStatistics(
        transcription="simulation",
        solver="mujoco",
        status="simulated",
        success=report.passed,
        converged=plan.converged,
        iterations=steps,
        objective=None,
        tolerance=plan.statistics.tolerance,
        wall_time_s=plan.statistics.wall_time_s,
        versions={**versions, "mujoco": mujoco_package().__version__},
        simulation=report.to_dict(),
        seed=plan.statistics.seed,
        perturb=plan.statistics.perturb,
        more=plan.statistics.more,
    )
