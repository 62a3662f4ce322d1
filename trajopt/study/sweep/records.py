"""What a sweep has found, on disk: one line of JSON for each thing, appended at once."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from trajopt.errors import InputError
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import DEFAULT_SOLVER, check_settings
from trajopt.study.suite.settings import MOST_STARTS
from trajopt.study.sweep.plan import Plan
from trajopt.study.sweep.result import Job, Run
from trajopt.study.sweep.setting import Setting

FILE = "record.jsonl"
SOLUTIONS = "solutions"
REFERENCE = "reference.npz"
# What a folder of another sweep differs in, in words.
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
class Asked:
    """What is swept: the problem by name with values of its parameters, and how its settings are run.

    repeats: perturbed starts besides the own guess, with seeds 1 to repeats: the same ones for every setting.
    sigma: their noise in scaled units. max_iterations, max_time (s): of one solve. build_time: s beyond that
    time, for graphs, transcription and the C compiler on a busy machine, after which a run is ended.
    reference_time: s that the reference may take, 0 for none. Raises InputError for values that are none.
    """

    problem: str
    values: Mapping[str, str]
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
        """Every setting's starts, 0 the own guess."""
        return tuple(range(self.repeats + 1))

    def head(self, plan: Plan, versions: Mapping[str, str]) -> dict[str, Any]:
        """What a folder must agree in for a sweep to go on in it."""
        values = {name: value for name, value in asdict(self).items() if name != "reference_time"}
        settings = [setting.name for setting in plan.settings]
        return {**values, "settings": settings, "versions": dict(versions)}


@dataclass(kw_only=True)
class Found:
    """All that is known: runs by job, accuracy by setting, s of calibrations, the reference's text.

    ``compiled`` are times and counts of what was compiled before the runs, by `Setting.functions`.

    ``accuracy`` holds for each setting the job whose solution was measured, whether against the reference,
    and the figures by column, None where they could not be had.
    """

    runs: dict[Job, Run] = field(default_factory=dict)
    accuracy: dict[str, tuple[Job, bool, dict[str, float | None]]] = field(default_factory=dict)
    calibrations: list[float] = field(default_factory=list)
    reference: dict[str, Any] | None = None
    compiled: dict[str, dict[str, Any]] = field(default_factory=dict)

    def attempts(self, setting: str, start: int) -> list[Run]:
        """Runs of one setting from one start, in order."""
        found = [run for run in self.runs.values() if (run.setting, run.start) == (setting, start)]
        return sorted(found, key=lambda run: run.attempt)

    def best(self, setting: str, start: int) -> Run | None:
        """The attempt that was disturbed least: the first that was not, else that of the fastest machine."""
        tried = self.attempts(setting, start)
        calm = [run for run in tried if not run.disturbed]
        if calm:
            return calm[0]
        return min(tried, key=lambda run: run.calibration or float("inf")) if tried else None


class Records:
    """The folder of a sweep. Raises InputError where it cannot be written, or holds another sweep."""

    def __init__(self, folder: Path, head: Mapping[str, Any], *, resume: bool) -> None:
        self.folder, self._head = folder.expanduser(), dict(head)
        self._file = self.folder / FILE
        self.found = Found()
        try:
            (self.folder / SOLUTIONS).mkdir(parents=True, exist_ok=True)
            if resume and self._file.exists():
                self._read()
            else:
                self._file.write_text(json.dumps({"head": self._head}) + "\n", encoding="utf-8")
                for stale in (self.reference_file, *(self.folder / SOLUTIONS).glob("*.npz")):
                    stale.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot write {self._file}: {error.strerror or error}",
                "allowed: a folder that can be written",
            ) from None

    @property
    def reference_file(self) -> Path:
        """Where the reference solution lies."""
        return self.folder / REFERENCE

    def solution_file(self, setting: Setting, job: Job) -> Path:
        """Where the solution of a run lies."""
        return self.folder / SOLUTIONS / f"{setting.slug()}.{job.start}.{job.attempt}.npz"

    def add_run(self, run: Run) -> None:
        """Keep one run."""
        self._take({"run": run.to_dict()})

    def add_accuracy(self, job: Job, against_reference: bool, figures: Mapping[str, float | None]) -> None:
        """Keep the figures of one solution."""
        self._take({"accuracy": [asdict(job), against_reference, dict(figures)]})

    def add_reference(self, values: Mapping[str, Any]) -> None:
        """Keep what is known of the reference: ``ok`` and a ``text``."""
        self._take({"reference": dict(values)})

    def add_compiled(self, functions: str, values: Mapping[str, Any]) -> None:
        """Keep what compiling some functions took."""
        self._take({"compiled": [functions, dict(values)]})

    def add_calibrations(self, seconds: list[float]) -> None:
        """Keep calibrations of a machine at rest."""
        self._take({"calibrations": seconds})

    def _take(self, entry: dict[str, Any]) -> None:
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")
        self._apply(entry)

    def _apply(self, entry: Mapping[str, Any]) -> None:
        if "run" in entry:
            run = Run.from_dict(entry["run"])
            self.found.runs[run.job] = run
        elif "accuracy" in entry:
            job, against_reference, figures = entry["accuracy"]
            self.found.accuracy[job["setting"]] = (Job(**job), bool(against_reference), dict(figures))
        elif "reference" in entry:
            self.found.reference = dict(entry["reference"])
        elif "compiled" in entry:
            functions, values = entry["compiled"]
            self.found.compiled[functions] = dict(values)
        elif "calibrations" in entry:
            self.found.calibrations += [float(value) for value in entry["calibrations"]]

    def _read(self) -> None:
        text = self._file.read_text(encoding="utf-8")
        lines = text.splitlines()
        try:
            head = json.loads(lines[0])["head"]
        except (ValueError, KeyError, TypeError, IndexError):
            head = {}
        for name, words in HEAD.items():
            if not isinstance(head, dict) or head.get(name) != self._head[name]:
                raise InputError(
                    f"{self.folder} holds a sweep with {words}",
                    "allowed: the same command with --resume, or another --output-dir",
                )
        for line in lines[1:]:
            try:
                self._apply(json.loads(line))
            except (ValueError, KeyError, TypeError):  # a line cut off by a crash: it is done again
                continue
        if not text.endswith("\n"):
            with self._file.open("a", encoding="utf-8") as stream:
                stream.write("\n")
