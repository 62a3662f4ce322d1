"""A sweep from its plan to its records: timed runs in rounds, then the reference, then accuracy.

Rounds go over all settings before any is run again, so that a slow minute of the machine hits all alike. A
run that was disturbed is made again at the end of the queue, at most `RETRIES` times.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Protocol

from trajopt.solving.monitoring import GRACE
from trajopt.study.sweep.plan import Plan
from trajopt.study.sweep.process import Pool
from trajopt.study.sweep.records import Asked, Records
from trajopt.study.sweep.result import LOST, NOT_COMPILED, Job, Run
from trajopt.study.sweep.summary import median_run

# Beyond this multiple of the fastest calibration the machine is not what it was; on an idle machine they
# spread by a few per cent (docs/front.md).
DISTURBED_LOAD = 1.15
# A timed process that has its core for less than this part of the time shares it.
LEAST_SHARE = 0.95
RETRIES = 2
# All repeated runs are at most this part of the plan: on a machine that is never quiet nothing is gained.
MOST_AGAIN = 0.25
# After so many lost processes a setting is not run again.
MOST_LOST = 2
# s that measuring one solution may take.
ACCURACY_TIME = 300.0
# s that a run takes however small it is.
LEAST_SECONDS = 0.3
# Calibrations of the machine at rest, before anything is run.
CALIBRATIONS = 20


class Display(Protocol):
    """What shows the progress; called from the main thread alone."""

    def note(self, text: str) -> None:
        """Something to say."""

    def left(self, count: int) -> None:
        """So many tasks are left."""

    def started(self, text: str) -> None:
        """A task begins."""

    def finished(self, text: str) -> None:
        """A task has ended."""


class Sweep:
    """One sweep, run step by step; what is found is in ``records`` at once."""

    def __init__(self, asked: Asked, plan: Plan, records: Records, pool: Pool, display: Display) -> None:
        self._asked, self._plan, self._records = asked, plan, records
        self._pool, self._display = pool, display
        self._settings = {setting.name: setting for setting in plan.settings}
        self._labels = {name: setting.label(plan.base) for name, setting in self._settings.items()}
        self._lost: Counter[str] = Counter()
        self._given_up: set[str] = set()
        self._told = False
        repeated = sum(run.attempt > 0 for run in records.found.runs.values())
        self._again = math.ceil(MOST_AGAIN * len(plan.settings) * len(asked.starts)) - repeated

    def run(self) -> None:
        """Everything that is not recorded yet."""
        self._compile()
        self._calibrate()
        self._runs()
        if self._asked.reference_time > 0:
            self._reference()
        self._accuracy()

    def _compile(self) -> None:
        """Functions of all settings, before anything is timed, by compilers on all cores.

        Settings whose functions cannot be had are given up: a run that says so is recorded.
        """
        asked, found = self._asked, self._records.found
        for name, setting in self._settings.items():
            if setting.functions not in found.compiled and not found.attempts(name, 0):
                self._display.started(f"{self._labels[name]}: compiling")
                task = {"task": "compile", "setting": setting.to_dict(), "limit": asked.build_time}
                answer = self._pool.ask({**self._problem_of_task(), **task})
                self._records.add_compiled(setting.functions, answer)
                if answer.get("functions_compiled"):
                    self._display.finished(f"{setting.functions}: compiled in {answer['compile_time']:.1f} s")
            answer = found.compiled.get(setting.functions, {"kind": "done"})
            if answer["kind"] != "done" and not found.attempts(name, 0):
                job = Job(setting=name, start=0)
                self._records.add_run(Run(**asdict(job), status=NOT_COMPILED, detail=answer["detail"]))
                self._display.finished(f"{self._labels[name]}: not compiled ({answer['detail']})")

    def _calibrate(self) -> None:
        if not self._records.found.calibrations:
            answer = self._pool.ask({"task": "calibration", "count": CALIBRATIONS, "limit": GRACE})
            self._records.add_calibrations(answer.get("seconds", []))

    @property
    def _least_load(self) -> float:
        """The fastest calibration so far, s."""
        found = self._records.found
        known = [run.calibration for run in found.runs.values() if run.calibration is not None]
        return min([*found.calibrations, *known], default=float("inf"))

    def _runs(self) -> None:
        waiting = deque(self._missing())
        begun: dict[Job, float] = {}
        while waiting or self._pool.is_busy:
            while waiting and self._pool.has_free:
                job = waiting.popleft()
                if job.setting not in self._given_up:
                    begun[job] = time.perf_counter()
                    self._display.left(len(waiting) + 1)
                    self._display.started(f"{self._labels[job.setting]}, {_start_text(job)}")
                    self._pool.start(job, self._run_task(job))
            if not self._pool.is_busy:
                continue
            job, answer = self._pool.take()
            run = self._judged(job, answer)
            self._records.add_run(run)
            self._display.finished(f"{self._labels[job.setting]}, {_start_text(job)}: {run_text(run)}")
            self._estimate(run, time.perf_counter() - begun[job], waiting)
            if run.disturbed and job.attempt < RETRIES and self._again > 0:
                self._again -= 1
                waiting.append(replace(job, attempt=job.attempt + 1))

    def _missing(self) -> list[Job]:
        """Jobs of all rounds that are neither recorded nor given up; attempts go on where they ended."""
        jobs, found = [], self._records.found
        for start in self._asked.starts:
            for name in self._settings:
                tried = found.attempts(name, start)
                for run in tried:
                    self._count(run)
                if not tried:
                    jobs.append(Job(setting=name, start=start))
                elif all(run.disturbed for run in tried) and tried[-1].attempt < RETRIES and self._again > 0:
                    self._again -= 1
                    jobs.append(Job(setting=name, start=start, attempt=tried[-1].attempt + 1))
        return jobs

    def _run_task(self, job: Job) -> dict[str, Any]:
        asked, setting = self._asked, self._settings[job.setting]
        solves = 2 if setting.start == "warm" else 1
        return {
            **self._problem_of_task(),
            "task": "run",
            "setting": setting.to_dict(),
            "job": asdict(job),
            "limits": {name: getattr(asked, name) for name in ("sigma", "max_iterations", "max_time")},
            "file": str(self._records.solution_file(setting, job)),
            "limit": solves * asked.max_time + asked.build_time,
        }

    def _problem_of_task(self) -> dict[str, Any]:
        return {"problem": self._asked.problem, "values": dict(self._asked.values)}

    def _judged(self, job: Job, answer: Mapping[str, Any]) -> Run:
        """The run of an answer, with what the calibrations say of it."""
        if "run" not in answer:
            run = Run(**asdict(job), status=answer["kind"], detail=answer["detail"])
        else:
            run = Run.from_dict(answer["run"])
            slow = (run.calibration or 0.0) > DISTURBED_LOAD * self._least_load
            run = replace(run, disturbed=slow or (run.cpu_share or 1.0) < LEAST_SHARE)
        self._count(run)
        return run

    def _count(self, run: Run) -> None:
        """A setting that is refused, or lost too often, is given up."""
        self._lost[run.setting] += run.status == LOST
        if run.is_final or self._lost[run.setting] >= MOST_LOST:
            self._given_up.add(run.setting)

    def _estimate(self, run: Run, seconds: float, waiting: deque[Job]) -> None:
        """Say once, after the first run, how long the others will take: as long by collocation points."""
        if self._told or not waiting:
            return
        self._told = True
        once = (run.compile_time or 0.0) + (run.build_time or 0.0) * bool(run.functions_compiled)
        per_point = (seconds - once) / self._settings[run.setting].points
        total = sum(LEAST_SECONDS + per_point * self._settings[job.setting].points for job in waiting)
        self._display.note(
            f"{len(waiting)} runs are left, about {total / 60:.1f} min without the compiler's; then accuracy"
        )

    def _reference(self) -> None:
        """The converged reference, once; a failure is recorded: it tells why its figures are missing."""
        known = self._records.found.reference
        if known is not None and (self._records.reference_file.exists() or not known["ok"]):
            return
        self._display.started("reference")
        limit = self._asked.reference_time
        answer = self._pool.ask(
            {
                **self._problem_of_task(),
                "task": "reference",
                "file": str(self._records.reference_file),
                "compile": self._plan.base.compile,
                "max_time": limit,
                "limit": limit + self._asked.build_time,
            }
        )
        ok = answer["kind"] == "done"
        text = answer["text"] if ok else answer["detail"]
        self._records.add_reference({"ok": ok, "text": text})
        self._display.finished(f"reference: {text}")

    def _accuracy(self) -> None:
        """The accuracy of each setting's median run."""
        waiting = deque(self._unmeasured())
        reference = self._records.reference_file if self._records.reference_file.exists() else None
        while waiting or self._pool.is_busy:
            while waiting and self._pool.has_free:
                run = waiting.popleft()
                self._display.left(len(waiting) + 1)
                self._display.started(f"{self._labels[run.setting]}: accuracy")
                task = {
                    "task": "accuracy",
                    "file": str(self._records.solution_file(self._settings[run.setting], run.job)),
                    "reference": None if reference is None else str(reference),
                    "limit": ACCURACY_TIME,
                }
                self._pool.start(run, task)
            run, answer = self._pool.take()
            self._records.add_accuracy(run.job, reference is not None, answer.get("figures", {}))
            if "figures" not in answer:
                self._display.note(f"{self._labels[run.setting]}: no accuracy: {answer['detail']}")

    def _unmeasured(self) -> list[Run]:
        found, missing = self._records.found, []
        has_reference = self._records.reference_file.exists()
        for name in self._settings:
            run = median_run(found, name, self._asked.starts)
            if run is not None and run.success:
                job, against, _ = found.accuracy.get(name, (None, False, {}))
                if job != run.job or against != has_reference:
                    missing.append(run)
        return missing


def _start_text(job: Job) -> str:
    start = "own guess" if job.start == 0 else f"start {job.start}"
    return start + (f", attempt {job.attempt + 1}" if job.attempt else "")


def run_text(run: Run) -> str:
    """A run in a few words."""
    if run.wall_time is None:
        return f"{run.status} ({run.detail})"
    verdict = "solved" if run.success else f"NOT solved ({run.detail})"
    disturbed = ", disturbed" if run.disturbed else ""
    return f"{verdict}, {run.iterations} iterations, {run.wall_time + run.start_time:.3f} s{disturbed}"
