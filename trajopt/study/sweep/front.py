"""A measured front: how long each setting took and how accurate it was, to choose settings from.

A front is a table, ``settings.csv`` of `trajopt sweep`, read back. It holds for the problem and the machine
it was measured on; to others only times relative to the default setting, errors over the robot's length and
intervals per natural time sqrt(length / g) carry over, approximately.
"""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from trajopt.errors import InputError
from trajopt.study.sweep.pareto import GAIN, front
from trajopt.study.sweep.setting import Setting

FOLDER = Path(__file__).parent / "fronts"
SUFFIX = ".csv"

SettingFilter = Callable[[Setting], bool]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One setting and its results: medians over its runs.

    density: intervals per natural time, sqrt(length / g). time: s, of the solver and of the solve for its
    start. relative_time: over that of the default setting. error: m, open loop, worst phase. relative_error:
    over the robot's length. success_rate: fraction of the runs that were solved. variables: of the NLP.
    calibration: time of the fixed load beside its runs, s.
    """

    setting: Setting
    density: float
    time: float
    relative_time: float
    error: float
    relative_error: float
    success_rate: float
    variables: float
    calibration: float

    @property
    def objectives(self) -> tuple[float, float]:
        """The point of a front: time and error."""
        return self.time, self.error


@dataclass(frozen=True, kw_only=True)
class Front:
    """The measured settings of one problem on one robot, in order of time; ``default`` is the problem's own.

    kind: of `likeness.motion_kind`. n_velocities: nv. natural_time: sqrt(length / g) of the robot, s.
    length: m.
    """

    problem: str
    robot: str
    kind: str
    n_velocities: int
    natural_time: float
    length: float
    default: Measured
    points: tuple[Measured, ...]

    @property
    def calibration(self) -> float:
        """Median time of the fixed load over all settings, s: how fast the machine was."""
        return statistics.median(point.calibration for point in self.points)

    def best(self, where: SettingFilter | None = None, least_success: float = 0.0) -> tuple[Measured, ...]:
        """The settings that no other dominates, fastest first, among those that ``where`` accepts.

        least_success: fraction of the runs that must have been solved.
        """
        chosen = [
            point
            for point in self.points
            if point.success_rate >= least_success and (where is None or where(point.setting))
        ]
        return tuple(chosen[i] for i in front([point.objectives for point in chosen], GAIN))

    def for_accuracy(
        self, relative_error: float, where: SettingFilter | None = None, least_success: float = 0.0
    ) -> Measured | None:
        """The fastest setting with at most that error over the robot's length; None where there is none."""
        best = self.best(where, least_success)
        return next((point for point in best if point.relative_error <= relative_error), None)

    def for_budget(self, relative_time: float, where: SettingFilter | None = None) -> Measured | None:
        """The most accurate setting with at most that time over the default's; None where there is none."""
        fitting = [point for point in self.best(where) if point.relative_time <= relative_time]
        return fitting[-1] if fitting else None


def packaged_fronts() -> tuple[str, ...]:
    """Names of the fronts that come with the library."""
    return tuple(sorted(file.stem for file in FOLDER.glob(f"*{SUFFIX}")))


def load_front(name: str | Path) -> Front:
    """Read the front of that name, or a ``settings.csv``; settings that were not solved are left out.

    Raises InputError for a file that is missing or not such a table.
    """
    path = FOLDER / f"{name}{SUFFIX}" if str(name) in packaged_fronts() else Path(name)
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "no table"
        known = ", ".join(packaged_fronts())
        raise InputError(
            f"cannot read the front {path}: {reason}", f"allowed: settings.csv of a sweep, or one of {known}"
        ) from None
    own = next((row.get("compile") for row in rows if row.get("is_default") == "1"), None)
    # Tables of earlier versions have settings of several compile levels: only the default's still exists.
    rows = [row for row in rows if row.get("compile") == own]
    found = [(row, _measured(path, row)) for row in rows if _is_complete(row)]
    default = next((point for row, point in found if row.get("is_default") == "1"), None)
    if default is None:
        raise InputError(
            f"the default setting is not among the solved ones of {path}", "allowed: a sweep with it"
        )
    points = tuple(sorted((point for _, point in found), key=lambda point: point.objectives))
    head = rows[0]
    return Front(
        problem=head["problem"],
        robot=head["robot"],
        kind=head["kind"],
        n_velocities=int(_number(path, head, "n_velocities")),
        natural_time=_number(path, head, "natural_time_s"),
        length=_number(path, head, "length_m"),
        default=default,
        points=points,
    )


def _is_complete(row: Mapping[str, str]) -> bool:
    """Whether a row has a time and an error, finite ones."""
    try:
        return all(math.isfinite(float(row[name])) for name in ("time_s", "error_m"))
    except (KeyError, TypeError, ValueError):
        return False


def _measured(path: Path, row: Mapping[str, str]) -> Measured:
    return Measured(
        setting=Setting.from_dict(row),
        density=_number(path, row, "intervals_per_natural_time"),
        time=_number(path, row, "time_s"),
        relative_time=_number(path, row, "relative_time"),
        error=_number(path, row, "error_m"),
        relative_error=_number(path, row, "relative_error"),
        success_rate=_number(path, row, "success_rate"),
        variables=_number(path, row, "variables"),
        calibration=_number(path, row, "calibration_s"),
    )


def _number(path: Path, row: Mapping[str, str], column: str) -> float:
    try:
        return float(row[column])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"column {column} of {path} has no number: {row.get(column)!r}") from None
