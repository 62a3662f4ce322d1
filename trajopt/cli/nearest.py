"""``trajopt solve --nearest``: the value of a parameter nearest to the one asked for that is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajopt.cli.grade import SOLVER_SETTINGS
from trajopt.cli.input import parse_settings, value_option
from trajopt.cli.progress import watched
from trajopt.cli.report import SolveReport
from trajopt.errors import InputError, not_among
from trajopt.solvers.status import Status

if TYPE_CHECKING:
    from trajopt.problem.family import Family
    from trajopt.problem.problem import Problem

nearest_option = value_option(
    "--nearest", "PARAMETER", "Search the nearest value that is solved, where --set's is not."
)


@dataclass(frozen=True, kw_only=True)
class Search:
    """From the default of a parameter towards the value asked for: its text, and the file of its motion."""

    family: Family
    fixed: dict[str, str]
    name: str
    first: float
    asked: float
    text: str
    target: Path

    @classmethod
    def of(cls, problem: str, settings: Sequence[str], name: str, target: Path) -> Search:
        """Raises `InputError` unless the parameter is a number with a default, and is set."""
        from trajopt.problem.catalogue import families
        from trajopt.problem.family import Parameter, choose

        family, fixed = choose(families(), problem), parse_settings(settings, "--set")
        numbers = {each.name: each for each in family.parameters if isinstance(each, Parameter)}
        if name not in numbers:
            raise not_among(numbers, name, f"{family.name} has no number '{name}'")
        if name not in fixed:
            allowed = f"allowed: with --set {name}=VALUE"
            raise InputError(f"--nearest {name} has no value to come near", allowed)
        text = fixed.pop(name)
        asked = numbers[name].parse(text)
        first = numbers[name].default
        if first is None:
            derived = family.load(fixed).parameters.get(name)
            if isinstance(derived, bool) or not isinstance(derived, (int, float)):
                allowed = f"allowed: {', '.join(numbers)}"
                raise InputError(f"'{name}' of {family.name} has no number as its default", allowed)
            first = float(derived)
        if first == asked:
            raise InputError(f"{name}={asked:g} is the default", f"allowed: another value of {name}")
        return cls(family=family, fixed=fixed, name=name, first=first, asked=asked, text=text, target=target)

    def run(self, failed: SolveReport, arguments: dict[str, Any]) -> SolveReport:
        """Search, save what is found, and add it to the report of the value asked for, which failed.

        The search may reach that value: then the report is of its motion.
        """
        from trajopt.solving.continuation import NEAREST_SOLVES, nearest

        if failed.solution.statistics.status == Status.INTERRUPTED.word:
            return failed

        def load(value: float) -> Problem:
            return self.family.load({**self.fixed, self.name: value})

        settings = {key: arguments[key] for key in (*SOLVER_SETTINGS, "transcription", "intervals")}
        most = arguments["max_time"] * NEAREST_SOLVES
        title = f"{arguments['title']}, nearest {self.name}"
        with watched(title, most, None, arguments["viewer"]) as callbacks:
            step = nearest(load, self.first, self.asked, **callbacks, **settings)
        if step is None:
            line = f"no value of {self.name} was solved, not even {self.first:g}, the default"
            return _with(failed, line, {"parameter": self.name, "value": None, "file": None})
        if step.value == self.asked and step.solution.success:
            return SolveReport(step.solution, True)
        file = step.solution.save(self.target.with_name(f"{self._stem(step.value)}.npz"))
        holds = "" if step.solution.success else " at its points"
        line = f"nearest value of {self.name} that was solved{holds}: {step.value:.4g}, in {file}"
        entry = {"parameter": self.name, "value": step.value, "holds": step.solution.success}
        return _with(failed, line, {**entry, "file": str(file)})

    def _stem(self, value: float) -> str:
        """The target's, with the value in place of the one asked for, or behind."""
        stem, old, new = self.target.stem, f"{self.name}={self.text}", f"{self.name}={value:.4g}"
        return stem.replace(old, new) if old in stem else f"{stem}-{new}"


def wants_other_way(arguments: dict[str, Any]) -> bool:
    """Whether the options ask for several solves of another kind."""
    names = ("ladder", "accuracy", "budget")
    return bool(arguments["compare"]) or any(arguments[name] is not None for name in names)


def _with(report: SolveReport, line: str, entry: dict[str, Any]) -> SolveReport:
    return replace(report, notes=[*report.notes, line], extra={**report.extra, "nearest": entry})
