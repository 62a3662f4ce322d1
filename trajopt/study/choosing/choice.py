"""Which setting to solve a problem with, from the measured fronts of problems like it.

A front was measured on one problem and machine. It carries over to others in natural units: intervals per
natural time sqrt(l / g), errors over the robot's length, time per variable, and the time of an unchanging
load (`sweep.calibration`) for the machine. The prediction is only a first guess: the solution is measured
(``solve_to``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajopt.problem.problem import Problem
from trajopt.robot.units import Units
from trajopt.solving.rounds import unknowns_on_mesh
from trajopt.study.sweep.calibration import Load
from trajopt.study.sweep.front import Front, Measured, SettingFilter, load_front, packaged_fronts
from trajopt.study.sweep.likeness import motion_kind
from trajopt.study.sweep.setting import Setting
from trajopt.transcription.mesh import Mesh

# On coarse grids some starts fail: a setting with a lower success rate than this is not chosen.
LEAST_SUCCESS = 0.9
# The machine's speed is that of the fastest of ``TRIES`` medians of ``LOADS`` loads, some 30 ms in all: other
# load at this moment may end before the solve begins.
TRIES, LOADS = 5, 5


@dataclass(frozen=True, kw_only=True)
class ChosenSetting:
    """A measured setting on the problem's own grid, and what is predicted of it: error in m, time in s."""

    front: str
    measured: Measured
    mesh: Mesh
    predicted_error: float
    predicted_time: float

    @property
    def solver(self) -> dict[str, Any]:
        """Arguments of `trajopt.solve` besides the mesh."""
        setting = self.measured.setting
        return {"solver": setting.solver, "hessian": setting.hessian, "tolerance": setting.tolerance}

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "front": self.front,
            "transcription": self.mesh.transcription,
            "intervals": sum(self.mesh.counts),
            **self.solver,
            "predicted_error_m": self.predicted_error,
            "predicted_time_s": self.predicted_time,
        }


def front_for(problem: Problem, front: str | Path | None = None) -> tuple[str, Front]:
    """The front of that name or file; default: of the problem itself, or of one of its kind and size.

    Raises InputError for an invalid front.
    """
    if front is not None:
        return str(front), load_front(front)
    known = {name: load_front(name) for name in packaged_fronts()}
    kind, nv = motion_kind(problem), problem.robot.nv

    def unlike(name: str) -> tuple[bool, bool, float]:
        found = known[name]
        own = found.problem == problem.name and found.robot == problem.robot.name
        return not own, found.kind != kind, abs(math.log(found.n_velocities / nv))

    name = min(known, key=unlike)
    return name, known[name]


def choose_for_accuracy(
    problem: Problem, accuracy: float, *, front: str | Path | None = None, where: SettingFilter | None = None
) -> ChosenSetting:
    """The fastest setting whose error is predicted to be at most ``accuracy`` m, or the most accurate one.

    where: settings that are allowed, such as those of one solver.
    """
    name, known = front_for(problem, front)
    allowed = _allowed(problem, known, where)
    found = known.for_accuracy(accuracy / problem.robot.length, allowed, LEAST_SUCCESS)
    best = found or _points(known, allowed)[-1]
    return _choice(problem, name, best, machine_speed(known))


def choices_by_time(
    problem: Problem, *, front: str | Path | None = None, where: SettingFilter | None = None
) -> tuple[ChosenSetting, ...]:
    """The front's settings with their predicted times and errors, fastest first."""
    name, known = front_for(problem, front)
    speed = machine_speed(known)
    points = _points(known, _allowed(problem, known, where))
    choices = (_choice(problem, name, point, speed) for point in points)
    return tuple(sorted(choices, key=lambda choice: choice.predicted_time))


def machine_speed(front: Front) -> float:
    """Time of the unchanging load here over that beside the front's runs."""
    load = Load()
    return min(load.seconds(LOADS) for _ in range(TRIES)) / front.calibration


def _allowed(problem: Problem, front: Front, where: SettingFilter | None) -> SettingFilter:
    """Settings that the problem can take: its own terms, the whole model, a cold start."""
    own = front.default.setting
    plain = (own.cone, "full", "cold")

    def allowed(setting: Setting) -> bool:
        usual = (setting.cone, setting.model, setting.start) == plain
        takes = True
        return usual and takes and (where is None or where(setting))

    return allowed


def _points(front: Front, allowed: SettingFilter) -> tuple[Measured, ...]:
    """The front among the settings that are allowed, fastest first; at least the default."""
    return front.best(allowed, LEAST_SUCCESS) or (front.default,)


def _choice(problem: Problem, name: str, point: Measured, speed: float) -> ChosenSetting:
    units = Units(problem.robot)
    total = round(point.density * problem.schedule.duration / units.time)
    least = len(problem.schedule.phases)
    mesh = Mesh.uniform(point.setting.transcription, problem.schedule.intervals(max(total, least)))
    return ChosenSetting(
        front=name,
        measured=point,
        mesh=mesh,
        predicted_error=point.relative_error * units.length,
        predicted_time=point.time * speed * unknowns_on_mesh(problem, mesh) / point.variables,
    )
