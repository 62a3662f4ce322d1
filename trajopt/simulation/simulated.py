"""A simulated motion as a solution, for replay, plots and the file format.

Phases are the planned ones, by time; the posture held after the plan is one more. A contact is active in an
interval where it carries load; in the first interval of a phase also if the plan has it active, since a file
names the surfaces of a phase by its contacts. Accelerations, torques and forces are the simulated ones at the
samples; an interval has one collocation point, at its middle.
"""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from trajopt.control.reference import ContactTimeline
from trajopt.motion.consistency import rows_of
from trajopt.motion.description import PlanDescription
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import SolveStatistics
from trajopt.robot.actuators.joint_force import joint_force
from trajopt.robot.mujoco_package import mujoco_package
from trajopt.simulation.figures import loaded_contacts
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.report import MotionReport
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.versions import VERSIONED, installed_version

# Controller periods per interval: 4 ms by default, finer than a video frame.
PERIODS = 4


@dataclass(frozen=True, kw_only=True)
class SimulatedMotion:
    """A simulated motion, with everything recorded.

    Args:
        scene: the simulated scene.
        settings: settings of the simulation.
        timeline: the ticks of the record.
        record: the record.
        report: the report on the motion; None is no success.
        plan: the plan that was executed, if any.
    """

    scene: Scene
    settings: SimulationSettings
    timeline: ContactTimeline
    record: SimulationRecord
    report: MotionReport | None = None
    plan: Solution | None = None

    def as_solution(self) -> Solution:
        """The motion as a solution of the same model; ``statistics.simulated`` is true."""
        return self._solution

    @cached_property
    def _solution(self) -> Solution:
        scene, timeline, record = self.scene, self.timeline, self.record
        n, robot = len(record.feet), scene.robot
        steps = round(n * timeline.period / scene.compiled.opt.timestep)
        chunks = _chunks(timeline.phase[:n])
        rows = np.array([[first, first + (end - first) // 2, end] for first, end in chunks]).ravel()
        last = np.minimum(rows, n - 1)  # accelerations and forces are known at the starts of periods
        q = scene.coordinates.from_mujoco(record.qpos)
        v = scene.coordinates.rates_from_mujoco(record.qpos, record.qvel)
        a = scene.coordinates.accelerations_from_mujoco(record.qpos[:n], record.qvel[:n], record.qacc)
        t = np.append(timeline.t[:n], timeline.t[n - 1] + timeline.period)
        phase = np.array([timeline.phase[first] for first, _ in chunks])
        wrenches = (*robot.description.wrenches, *self.settings.wrenches)
        # MuJoCo's joint friction includes that of the joints themselves.
        own = joint_force(robot.model, robot.description.joint_forces, q[last], v[last])
        return Solution(
            description=replace(_description(scene, timeline, phase), wrenches=wrenches),
            statistics=_statistics(self.report, steps, self.plan),
            model=robot.model,
            t=t[rows],
            phase=np.repeat(phase, 3),
            interval=np.repeat(np.arange(len(chunks)), 3),
            collocation=np.tile([False, True, False], len(chunks)),
            interval_t=t[np.array(chunks)],
            q=q[rows],
            v=v[rows],
            a=a[last],
            tau=(record.torque + record.friction)[last] - robot.actuation.inputs(own),
            f=record.force[last],
            active=np.repeat(_active(scene, timeline, record, chunks), 3, axis=0),
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
    scene: Scene, timeline: ContactTimeline, record: SimulationRecord, chunks: list[tuple[int, int]]
) -> np.ndarray:
    """Whether each contact is active (intervals, nc)."""
    loaded, held = loaded_contacts(record, scene), scene.site.held
    by_interval, before = [], -1
    for first, end in chunks:
        active = loaded[first:end].any(axis=0) | held[timeline.source[first]]
        if timeline.phase[first] != before:
            active |= timeline.active[first]
        by_interval.append(active)
        before = timeline.phase[first]
    return np.array(by_interval)


def _description(scene: Scene, timeline: ContactTimeline, phase: np.ndarray) -> PlanDescription:
    """The robot's description with the simulated phases (n_chunks,): not periodic, feet rolling as here."""
    used = int(phase[-1]) + 1
    source = [int(timeline.source[np.argmax(timeline.phase == i)]) for i in range(used)]
    planned = scene.robot.description
    return replace(
        planned,
        contacts=tuple(
            replace(contact, rolling=bool(rolls))
            for contact, rolls in zip(planned.contacts, scene.place.rolling, strict=True)
        ),
        periodicity=None,
        phase_names=tuple(timeline.phase_names[:used]),
        surfaces=tuple(planned.surfaces[i] for i in source) if planned.surfaces else (),
        patches=tuple(planned.patches[i] for i in source) if planned.patches else (),
        payloads=tuple(
            replace(body, phases=tuple(i for i, each in enumerate(source) if each in body.phases))
            for body in planned.payloads
        ),
    )


def _statistics(report: MotionReport | None, steps: int, plan: Solution | None) -> SolveStatistics:
    versions = {name: installed_version(name) for name in VERSIONED}
    kept: dict[str, Any] = {"converged": True, "tolerance": 0.0, "wall_time_s": 0.0}
    if plan is not None:
        kept = {name: getattr(plan.statistics, name) for name in (*kept, "seed", "perturb", "more")}
    return SolveStatistics(
        transcription="simulation",
        solver="mujoco",
        status="simulated",
        success=report is not None and report.passed,
        iterations=steps,
        objective=None,
        versions={**versions, "mujoco": mujoco_package().__version__},
        simulation=None if report is None else report.to_dict(),
        **kept,
    )
