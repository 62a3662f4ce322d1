"""Results of a sweep on disk: one line of JSON each, appended at once."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from trajopt.errors import InputError, expanded
from trajopt.problem import Problem
from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import DEFAULT_SOLVER, check_settings
from trajopt.study.suite.settings import MOST_STARTS
from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.result import Job, TimedRun
from trajopt.study.sweep.setting import Setting
from trajopt.study.workers.records import JsonLines

FILE = "record.jsonl"
SOLUTIONS = "solutions"
REFERENCE = "reference.npz"
# Key -> difference from a folder of another sweep, in words.
HEAD = {
    "problem": "another problem",
    "values": "other parameters",
    "settings": "another plan",
    "repeats": "another number of runs",
    "sigma": "other noise",
    "max_iterations": "another iteration limit",
    "max_time": "another time limit",
    "build_time": "another time limit",
    "versions": "other versions of the libraries",
}


@dataclass(frozen=True, kw_only=True)
class SweepRequest:
    """The subject of a sweep: a problem by name, values of its parameters, and how its settings are run.

    Args:
        repeats: perturbed starts besides the default guess, with seeds from 1, the same for every setting.
        sigma: their noise, scaled units.
        max_iterations, max_time: limits of one solve, the latter in s.
        build_time: s beyond that, for graphs, transcription and compilation, before a run is ended.
        reference_time: time limit of the reference, s; 0 for none.

    Raises InputError for invalid values.
    """

    problem: str
    values: Mapping[str, str] = field(default_factory=dict)
    repeats: int = 2
    sigma: float = 0.1
    max_iterations: int = 500
    max_time: float = 60.0
    build_time: float = 600.0
    reference_time: float = 300.0

    def __post_init__(self) -> None:
        check_settings(
            DEFAULT_SOLVER, StoppingCriteria().tolerance, self.max_iterations, self.max_time, self.sigma, 0
        )
        if not 0 <= self.repeats <= MOST_STARTS:
            raise InputError(f"repeats is {self.repeats}", f"allowed: 0 to {MOST_STARTS}")
        if self.repeats and not self.sigma > 0:
            raise InputError(f"perturb is {self.sigma:g}: all starts are the same", "allowed: > 0")
        if not (math.isfinite(self.reference_time) and self.reference_time >= 0):
            raise InputError(f"reference is {self.reference_time:g} s", "allowed: 0 (none) or more")

    @property
    def starts(self) -> tuple[int, ...]:
        """Starts of every setting; 0 is the default guess."""
        return tuple(range(self.repeats + 1))

    def load(self) -> Problem:
        """The problem. Raises InputError for an invalid name or values."""
        return choose(families(), self.problem).load(self.values)

    def head(self, plan: SweepPlan, versions: Mapping[str, str]) -> dict[str, Any]:
        """The values that must agree for a sweep to resume in a folder."""
        values = {name: value for name, value in asdict(self).items() if name != "reference_time"}
        settings = [setting.name for setting in plan.settings]
        return {**values, "settings": settings, "versions": dict(versions)}


@dataclass(kw_only=True)
class SweepResults:
    """All results of a sweep.

    runs: by job. calibrations: times, s. reference: ``ok`` and a ``text``. compiled: times and counts of
    functions compiled before the runs, by `Setting.functions`. accuracy: by setting, the job whose solution
    was measured, whether against the reference, and the figures by column, None if they failed.
    """

    runs: dict[Job, TimedRun] = field(default_factory=dict)
    accuracy: dict[str, tuple[Job, bool, dict[str, float | None]]] = field(default_factory=dict)
    calibrations: list[float] = field(default_factory=list)
    reference: dict[str, Any] | None = None
    compiled: dict[str, dict[str, Any]] = field(default_factory=dict)

    def attempts(self, setting: str, start: int) -> list[TimedRun]:
        """Runs of one setting from one start, in order."""
        runs = [run for run in self.runs.values() if (run.setting, run.start) == (setting, start)]
        return sorted(runs, key=lambda run: run.attempt)

    def best(self, setting: str, start: int) -> TimedRun | None:
        """The least disturbed attempt: the first undisturbed one, else that with the fastest calibration."""
        tried = self.attempts(setting, start)
        calm = [run for run in tried if not run.disturbed]
        if calm:
            return calm[0]
        return min(tried, key=lambda run: run.calibration or float("inf")) if tried else None

    def add(self, entry: Mapping[str, Any]) -> None:
        """Add one entry of a record.

        It is one of: run, by its fields; accuracy, with a job by its fields, whether against the reference,
        and figures; reference, with ``ok`` and a ``text``; compiled, with the functions and their figures;
        calibrations, in s. Raises KeyError, TypeError or ValueError for a damaged one.
        """
        if "run" in entry:
            run = TimedRun(**entry["run"])
            self.runs[run.job] = run
        elif "accuracy" in entry:
            job, against_reference, figures = entry["accuracy"]
            self.accuracy[job["setting"]] = (Job(**job), bool(against_reference), dict(figures))
        elif "reference" in entry:
            self.reference = dict(entry["reference"])
        elif "compiled" in entry:
            functions, values = entry["compiled"]
            self.compiled[functions] = dict(values)
        elif "calibrations" in entry:
            self.calibrations += [float(value) for value in entry["calibrations"]]


class SweepRecords:
    """The folder of a sweep. Raises InputError if it cannot be written, or holds another sweep."""

    def __init__(self, folder: Path, head: Mapping[str, Any], *, resume: bool) -> None:
        self.folder = expanded(folder)
        self.results = SweepResults()
        file = self.folder / FILE
        files = (self.folder / REFERENCE, *(self.folder / SOLUTIONS).glob("*.npz"))
        foreign = [] if file.exists() else [path for path in files if path.exists()]
        if foreign:
            raise InputError(f"{foreign[0]} is there, without a sweep", "allowed: another --output-dir")
        self._lines = JsonLines(file)
        resume = resume and file.exists()
        first, *entries = self._lines.open(resume=resume) or [{}]
        (self.folder / SOLUTIONS).mkdir(exist_ok=True)
        if not resume:
            self._lines.append({"head": dict(head)})
            for stale in (self.reference_file, *(self.folder / SOLUTIONS).glob("*.npz")):
                stale.unlink(missing_ok=True)
            return
        self._require(first.get("head"), head)
        for entry in entries:
            with suppress(ValueError, KeyError, TypeError):  # damaged: skipped, and run again
                self.results.add(entry)

    def _require(self, known: Any, head: Mapping[str, Any]) -> None:
        for name, words in HEAD.items():
            if not isinstance(known, dict) or known.get(name) != head[name]:
                raise InputError(
                    f"{self.folder} holds a sweep with {words}",
                    "allowed: the same command with --resume, or another --output-dir",
                )

    @property
    def reference_file(self) -> Path:
        """Path of the reference solution."""
        return self.folder / REFERENCE

    def solution_file(self, setting: Setting, job: Job) -> Path:
        """Path of a run's solution."""
        return self.folder / SOLUTIONS / f"{setting.slug()}.{job.start}.{job.attempt}.npz"

    def add(self, **entry: Any) -> None:
        """Record a result, see `SweepResults.add`."""
        self._lines.append(entry)
        self.results.add(entry)
