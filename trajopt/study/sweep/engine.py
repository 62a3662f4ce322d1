"""A sweep from its plan to its records: timed runs in rounds, then the reference, then accuracy.

Each round runs all settings once, so that a slow minute of the machine affects all alike. A disturbed run is
repeated at the end of the queue, at most `RETRIES` times.
"""

import math
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from trajopt.errors import InputError
from trajopt.problem.catalogue import problem_modules
from trajopt.solving.time_limits import GRACE
from trajopt.study.display import TaskDisplay
from trajopt.study.processes import LOST, REFUSED, ProcessPerTaskExecutor
from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.records import NOT_COMPILED, Job, SweepRecords, SweepRequest, TimedRun
from trajopt.study.sweep.run import calibrations, compiled, figures, run_job, solve_reference
from trajopt.study.sweep.summary import median_run
from trajopt.study.tasks import DONE, NOT_RUN, Ended, NotRunError, TimedCall, Workers

# A run is disturbed if its calibration exceeds this multiple of the fastest; on an idle machine they vary by
# a few per cent (docs/front.md).
DISTURBED_LOAD = 1.15
# A run is disturbed if its process has its core for less than this fraction of the time.
LEAST_SHARE = 0.95
RETRIES = 2
# Most repeated runs, as a fraction of the plan: on a machine that is never quiet they gain nothing.
MOST_REPEATS = 0.25
# After this many lost processes a setting is not run again.
MOST_LOST = 2
# Time limit for measuring one solution, s.
ACCURACY_TIME = 300.0
# Time of the shortest run, s.
LEAST_SECONDS = 0.3
# Calibrations of the machine at rest, before anything is run.
CALIBRATIONS = 20
# Modules loaded before the runs begin; the last would otherwise be loaded by the first re-integration.
MODULES = ("trajopt.study.sweep.engine", "scipy.integrate")
TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
Key = TypeVar("Key")


class Sweep:
    """One sweep, run step by step; results go to ``records`` at once.

    Args:
        request: what is swept.
        plan: its settings.
        records: its folder.
        cores: processors of the timed processes.
        display: shows what runs.
        checks: called several times a second while tasks run; an exception from one ends the sweep.
    """

    def __init__(
        self,
        request: SweepRequest,
        plan: SweepPlan,
        records: SweepRecords,
        cores: Sequence[int],
        display: TaskDisplay,
        checks: tuple[Callable[[], object], ...] = (),
    ) -> None:
        self._checks = checks
        self._request, self._plan, self._records = request, plan, records
        self._cores, self._display = cores, display
        self._settings = {setting.name: setting for setting in plan.settings}
        self._labels = {name: setting.label(plan.base) for name, setting in self._settings.items()}
        self._lost: Counter[str] = Counter()
        self._given_up: set[str] = set()
        self._estimated = False
        repeated = sum(run.attempt > 0 for run in records.results.runs.values())
        self._repeats = math.ceil(MOST_REPEATS * len(plan.settings) * len(request.starts)) - repeated

    def run(self) -> None:
        """Run everything that is not recorded yet; functions are compiled first."""
        with self._open_workers(1) as self._workers:
            self._compile()
        with self._open_workers(len(self._cores), self._cores) as self._workers:
            if not self._records.results.calibrations:
                values = self._values("fixed load", GRACE, calibrations, CALIBRATIONS)
                self._records.add(calibrations=values.get("seconds", []))
                self._display.finished()
            self._runs()
            if self._request.reference_time > 0:
                self._reference()
            self._accuracy()

    @contextmanager
    def _open_workers(self, jobs: int, cores: Sequence[int] = ()) -> Iterator[Workers]:
        modules = (*problem_modules(), *MODULES)
        with ProcessPerTaskExecutor(jobs, cores=cores, preload=modules) as executor:
            show = self._display.show
            yield Workers(executor=executor, window=lambda: jobs, checks=self._checks, show=show)

    def _each(self, waiting: deque[Key], make: Callable[[Key], TimedCall]) -> Iterator[Ended[Key]]:
        self._display.more(len(waiting))
        return self._workers.run(waiting, make)

    def _values(self, name: str, limit: float, function: Callable[..., Any], *args: Any) -> dict[str, Any]:
        """Run one task while nothing else runs, and return its result."""
        task = TimedCall(name=name, limit=limit, function=function, args=args)
        (ended,) = self._each(deque([name]), lambda name: task)
        return _values(ended)

    def _compile(self) -> None:
        """Compile the functions of all settings before anything is timed.

        Settings whose functions cannot be compiled are given up, and recorded as such a run.
        """
        request, results = self._request, self._records.results
        for name, setting in self._settings.items():
            if results.attempts(name, 0):
                continue
            if setting.functions not in results.compiled:
                values = self._values("compiling", request.build_time, compiled, request, setting)
                self._records.add(compiled=[setting.functions, values])
                text = f"{setting.functions}: compiled in {values.get('compile_time', 0):.1f} s"
                self._display.finished(text if values.get("functions_compiled") else "")
            values = results.compiled[setting.functions]
            if values["kind"] != DONE:
                job = asdict(Job(setting=name, start=0))
                run = TimedRun(**job, status=NOT_COMPILED, detail=values["detail"])
                self._records.add(run=asdict(run))
                self._display.note(f"{self._labels[name]}: not compiled ({values['detail']})")

    def _runs(self) -> None:
        waiting, begin = deque(self._missing()), time.perf_counter()
        for ended in self._each(waiting, self._task):
            if ended.kind == NOT_RUN:
                self._display.more(-1)
                continue
            run = self._judged(ended)
            self._records.add(run=asdict(run))
            self._display.finished(f"{ended.name}: {run_text(run)}")
            self._estimate(run, time.perf_counter() - begin, waiting)
            if run.disturbed and (again := self._repetition(run)):
                waiting.append(again)
                self._display.more()

    def _task(self, job: Job) -> TimedCall:
        """The task of a run. Raises `NotRunError` if its setting is given up."""
        request, setting = self._request, self._settings[job.setting]
        if job.setting in self._given_up:
            raise NotRunError(f"{self._labels[job.setting]} is given up")
        solves = 2 if setting.start == "warm" else 1
        limit = solves * request.max_time + request.build_time
        args = (request, setting, job, self._records.solution_file(setting, job))
        start = "default guess" if job.start == 0 else f"start {job.start}"
        attempt = f", attempt {job.attempt + 1}" if job.attempt else ""
        name = f"{self._labels[job.setting]}, {start}{attempt}"
        return TimedCall(name=name, limit=limit, function=run_job, args=args)

    def _missing(self) -> list[Job]:
        """Jobs of all rounds that are not recorded; attempts continue the recorded ones."""
        jobs, results = [], self._records.results
        for start in self._request.starts:
            for name in self._settings:
                tried = results.attempts(name, start)
                for run in tried:
                    self._count(run)
                if not tried:
                    jobs.append(Job(setting=name, start=start))
                elif all(run.disturbed for run in tried) and (again := self._repetition(tried[-1])):
                    jobs.append(again)
        return jobs

    def _repetition(self, run: TimedRun) -> Job | None:
        """The job that repeats a run, while repetitions are left."""
        if run.attempt >= RETRIES or self._repeats <= 0:
            return None
        self._repeats -= 1
        return replace(run.job, attempt=run.attempt + 1)

    def _judged(self, ended: Ended[Job]) -> TimedRun:
        """The run of an ended task, judged by the calibrations."""
        if ended.kind == DONE:
            run: TimedRun = ended.value
            slow = (run.calibration or 0.0) > DISTURBED_LOAD * self._records.results.least_load
            run = replace(run, disturbed=slow or (run.cpu_share or 1.0) < LEAST_SHARE)
        else:
            run = TimedRun(**asdict(ended.key), status=_status(ended), detail=ended.detail)
        self._count(run)
        return run

    def _count(self, run: TimedRun) -> None:
        """Count lost runs; a setting that is refused, or lost too often, is given up."""
        self._lost[run.setting] += run.status == LOST
        if run.is_final or self._lost[run.setting] >= MOST_LOST:
            self._given_up.add(run.setting)

    def _estimate(self, run: TimedRun, seconds: float, waiting: Collection[Job]) -> None:
        """After the first run, estimate the time of the others, in proportion to collocation points."""
        if self._estimated or not waiting:
            return
        self._estimated = True
        once = (run.compile_time or 0.0) + (run.build_time or 0.0) * bool(run.functions_compiled)
        per_point = (seconds - once) / self._settings[run.setting].points
        total = sum(LEAST_SECONDS + per_point * self._settings[job.setting].points for job in waiting)
        self._display.note(
            f"{len(waiting)} runs are left, about {total / 60:.1f} min without compiling; then accuracy"
        )

    def _reference(self) -> None:
        """Solve the converged reference once; a failure is recorded as the reason for missing figures."""
        known, file = self._records.results.reference, self._records.reference_file
        if known is not None and (file.exists() or not known["ok"]):
            return
        request = self._request
        limit = request.reference_time + request.build_time
        values = self._values("reference", limit, solve_reference, request, file)
        ok = values["kind"] == DONE
        text = values["text"] if ok else values["detail"]
        self._records.add(reference={"ok": ok, "text": text})
        self._display.finished(f"reference: {text}")

    def _accuracy(self) -> None:
        """Measure the accuracy of each setting's median run."""
        reference = self._records.reference_file if self._records.reference_file.exists() else None

        def make(run: TimedRun) -> TimedCall:
            file = self._records.solution_file(self._settings[run.setting], run.job)
            name = f"{self._labels[run.setting]}: accuracy"
            return TimedCall(name=name, limit=ACCURACY_TIME, function=figures, args=(file, reference))

        for ended in self._each(deque(self._unmeasured()), make):
            text, run, values = "", ended.key, _values(ended)
            if values.pop("kind") != DONE:
                text = f"{self._labels[run.setting]}: no accuracy: {values.pop('detail')}"
            self._records.add(accuracy=[asdict(run.job), reference is not None, values])
            self._display.finished(text)

    def _unmeasured(self) -> list[TimedRun]:
        results, missing = self._records.results, []
        has_reference = self._records.reference_file.exists()
        for name in self._settings:
            run = median_run(results, name, self._request.starts)
            if run is not None and run.success:
                job, against, _ = results.accuracy.get(name, (None, False, {}))
                if job != run.job or against != has_reference:
                    missing.append(run)
        return missing


def _status(ended: Ended[Any]) -> str:
    """`REFUSED`, or `LOST`, which includes the time limit."""
    return REFUSED if ended.kind == REFUSED else LOST


def _values(ended: Ended[Any]) -> dict[str, Any]:
    """The result of a task for the records: with its kind, and the detail of a lost one."""
    if ended.kind == DONE:
        return {"kind": DONE, **ended.value}
    return {"kind": _status(ended), "detail": ended.detail}


def run_text(run: TimedRun) -> str:
    """A run in a few words."""
    if run.wall_time is None:
        return f"{run.status} ({run.detail})"
    verdict = "solved" if run.success else f"NOT solved ({run.detail})"
    disturbed = ", disturbed" if run.disturbed else ""
    return f"{verdict}, {run.iterations} iterations, {run.wall_time + run.start_time:.3f} s{disturbed}"


def physical_cores() -> tuple[int, ...]:
    """One logical processor of each physical core that this process may use."""
    if not hasattr(os, "sched_getaffinity"):
        return tuple(range(os.cpu_count() or 1))
    firsts: dict[str, int] = {}
    for processor in sorted(os.sched_getaffinity(0)):
        try:
            siblings = Path(TOPOLOGY.format(processor)).read_text(encoding="ascii").strip()
        except OSError:
            siblings = str(processor)
        firsts.setdefault(siblings, processor)
    return tuple(sorted(firsts.values()))


def cores_for(jobs: int) -> tuple[int, ...]:
    """A core for each of ``jobs`` timed processes: the last ones, because the first handles the interrupts.

    Raises InputError for more than all physical cores but one; one process is always allowed.
    """
    cores = physical_cores()
    most = max(1, len(cores) - 1)
    if not 1 <= jobs <= most:
        raise InputError(
            f"jobs is {jobs}", f"allowed: 1 to {most} here, the physical cores but one: timed runs share none"
        )
    return cores[-jobs:]
