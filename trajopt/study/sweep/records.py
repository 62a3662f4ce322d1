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
from trajopt.study.processes import REFUSED
from trajopt.study.records import JsonLines
from trajopt.study.solves import MOST_STARTS
from trajopt.study.sweep.plan import SweepPlan
from trajopt.study.sweep.setting import Setting

# Status of a setting whose functions do not compile; others are the solver's, `REFUSED` and `LOST`.
NOT_COMPILED = "not_compiled"
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
class Job:
    """One run to make: a setting's name, the start (0: default guess, k: seed k), and the attempt."""

    setting: str
    start: int
    attempt: int = 0


@dataclass(frozen=True, kw_only=True)
class TimedRun(Job):
    """One solve and its times in s; unknown ones are None.

    Args:
        wall_time, function_time: the solver's; start_time: of the solve that made a warm start.
        stage_two_time, build_time, compile_time: of torques; of graphs and transcription; of compilation.
        iterations, objective: of all solves; the problem's own, even if a variant was solved.
        calibration: time of the load next to the run, s.
        cpu_share: fraction of the time, without compilation, in which the process had its core.
        disturbed: either is out of bounds. detail: why it was refused, lost or not solved.
    """

    status: str
    success: bool = False
    iterations: int | None = None
    wall_time: float | None = None
    start_time: float = 0.0
    stage_two_time: float = 0.0
    function_time: float | None = None
    build_time: float | None = None
    compile_time: float | None = None
    functions_compiled: int | None = None
    variables: int | None = None
    constraints: int | None = None
    objective: float | None = None
    max_violation: float | None = None
    calibration: float | None = None
    cpu_share: float | None = None
    disturbed: bool = False
    detail: str = ""

    @property
    def job(self) -> Job:
        """The job of this result."""
        return Job(setting=self.setting, start=self.start, attempt=self.attempt)

    @property
    def is_final(self) -> bool:
        """Whether repeating it is useless: the setting does not fit, or its functions do not compile."""
        return self.status in (REFUSED, NOT_COMPILED)

    @property
    def time(self) -> float:
        """Time that a user waits for a solve, s; infinite without a solution."""
        if not self.success or self.wall_time is None:
            return float("inf")
        return self.wall_time + self.start_time + self.stage_two_time


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

    @property
    def loads(self) -> list[float]:
        """Times of the fixed load next to the runs, s, ascending."""
        return sorted(run.calibration for run in self.runs.values() if run.calibration is not None)

    @property
    def least_load(self) -> float:
        """The least time of the fixed load, s; infinite if unknown."""
        return min([*self.calibrations, *self.loads], default=math.inf)

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
        file, solutions = self.folder / FILE, self.folder / SOLUTIONS
        written = [path for path in (self.reference_file, *solutions.glob("*.npz")) if path.exists()]
        if written and not file.exists():
            raise InputError(f"{written[0]} is there, without a sweep", "allowed: another folder")
        self._lines = JsonLines(file)
        entries = self._lines.begin("sweep", head, HEAD, resume=resume)
        solutions.mkdir(exist_ok=True)
        for path in [] if resume else written:
            path.unlink(missing_ok=True)
        for entry in entries:
            with suppress(ValueError, KeyError, TypeError):  # damaged: skipped, and run again
                self.results.add(entry)

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
