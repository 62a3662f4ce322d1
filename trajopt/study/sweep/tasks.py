"""What a worker is asked to do: a run, the accuracy of a solution, a reference, a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from trajopt.problem.catalogue import families as catalogue
from trajopt.problem.family import Family, choose
from trajopt.problem.problem import Problem
from trajopt.solving.reference import converged_reference
from trajopt.study.sweep.calibration import Load
from trajopt.study.sweep.cores import unpin
from trajopt.study.sweep.figures import figures
from trajopt.study.sweep.result import Job
from trajopt.study.sweep.run import Limits, compiled, run
from trajopt.study.sweep.setting import Setting

Task = Mapping[str, Any]


@lru_cache(maxsize=1)
def families() -> dict[str, Family]:
    """All families, found once a process."""
    return catalogue()


def _problem(task: Task) -> Problem:
    return choose(families(), task["problem"]).load(task["values"])


def _run(task: Task) -> dict[str, Any]:
    found = run(
        _problem(task),
        Setting.from_dict(task["setting"]),
        Job(**task["job"]),
        Limits(**task["limits"]),
        Path(task["file"]),
    )
    return {"run": found.to_dict()}


def _compile(task: Task) -> dict[str, Any]:
    unpin()
    return compiled(_problem(task), Setting.from_dict(task["setting"]))


def _accuracy(task: Task) -> dict[str, Any]:
    known = None if task["reference"] is None else Path(task["reference"])
    return {"figures": figures(Path(task["file"]), known)}


def _reference(task: Task) -> dict[str, Any]:
    found = converged_reference(_problem(task), max_time=task["max_time"], compile=task["compile"])
    found.solution.save(Path(task["file"]))
    return {"text": str(found)}


def _calibration(task: Task) -> dict[str, Any]:
    load = Load()
    return {"seconds": [load.seconds() for _ in range(task["count"])]}


KINDS: dict[str, Callable[[Task], dict[str, Any]]] = {
    "compile": _compile,
    "run": _run,
    "accuracy": _accuracy,
    "reference": _reference,
    "calibration": _calibration,
}
