"""A solution prepared for plotting: sampled between its points, with its phases, name, check and accuracy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from trajopt.certify.accuracy.measures import Accuracy, measure
from trajopt.certify.accuracy.open_loop import interval_drifts
from trajopt.certify.check import check
from trajopt.certify.report import CheckReport
from trajopt.errors import InputError, TrajoptError
from trajopt.motion.configurations import resampled, sample_interval
from trajopt.motion.interpolation import MotionSample
from trajopt.motion.solution import Solution
from trajopt.view.plotting import style
from trajopt.view.plotting.joints import JointAxis, axes_of
from trajopt.view.plotting.motion import PlottedMotion
from trajopt.view.replay.motion import PhaseSpan, phase_spans

# Approximate number of samples drawn of a motion: a line across a page has no more dots.
DRAWN = 1500
# Most samples of an interval (the polynomials' degree is at most four), and at least its two ends.
MOST, LEAST = 11, 2
# A jump between intervals by this fraction of a quantity's range leaves a gap in its curve: half a line's
# width.
JUMP = 0.005

# Values (K, ...) of a motion's samples.
MotionQuantity = Callable[[PlottedMotion], np.ndarray]
_Result = TypeVar("_Result")


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """One of several solutions in a plot.

    Args:
        label: its name.
        solution: the plan or simulated motion.
        number: among the solutions.
        dense: the interpolated motion.
        points: its own samples.
    """

    label: str
    solution: Solution
    number: int = 0
    dense: PlottedMotion = field(init=False)
    points: PlottedMotion = field(init=False)

    def __post_init__(self) -> None:
        plan = self.solution.normalized()
        object.__setattr__(self, "points", PlottedMotion(plan))
        object.__setattr__(self, "dense", PlottedMotion(between_points(plan)))

    @property
    def line_style(self) -> Any:
        """The line style of its curves."""
        return style.line_style(self.number)

    @property
    def is_simulated(self) -> bool:
        """Whether it is a simulated motion instead of a plan."""
        return self.solution.statistics.simulated

    @cached_property
    def is_finite(self) -> bool:
        """Whether every number of the motion is finite."""
        names = ("t", "q", "v", "a", "tau", "f")
        return all(bool(np.isfinite(getattr(self.solution, name)).all()) for name in names)

    @property
    def is_plan(self) -> bool:
        """Whether it comes from a transcription, with collocation points, and is finite."""
        return self.is_finite and not self.is_simulated

    @cached_property
    def axes(self) -> tuple[JointAxis, ...]:
        """The rows of v after the base."""
        return axes_of(self.solution)

    @cached_property
    def phases(self) -> tuple[PhaseSpan, ...]:
        """The phases in time order."""
        return tuple(replace(span, name=style.short(span.name)) for span in phase_spans(self.solution))

    @property
    def impact_times(self) -> list[float]:
        """Times of the impacts, s."""
        index = self.solution.impact_index
        return [] if index is None else [float(self.solution.t[row]) for row in index]

    @cached_property
    def report(self) -> CheckReport | None:
        """The check of the solution, None if it is inconsistent or not finite."""
        return tried(lambda: check(self.solution))

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """The accuracy of a plan, None for a simulated motion or if it cannot be measured."""
        return None if self.is_simulated else tried(lambda: measure(self.solution))

    @cached_property
    def local_errors(self) -> np.ndarray:
        """Local error (I,) m of every interval, see `accuracy.open_loop.interval_drifts`, or NaN."""
        measured = self.__dict__.get("accuracy")  # if already known: it takes a second
        if measured is not None:
            return np.asarray(measured.interval_errors)
        drifts = tried(lambda: interval_drifts(self.points))
        return np.full(self.solution.n_intervals, np.nan) if drifts is None else drifts

    def curve(self, values: MotionQuantity) -> tuple[np.ndarray, np.ndarray]:
        """Times and values of the interpolated motion, with NaN between where it jumps.

        ``values`` gives (K,) of a motion. Within an interval the curve is its polynomial; a quantity that
        differs on the two sides of a node has a gap there instead of a ramp.
        """
        y = np.asarray(values(self.dense), dtype=float)
        jumps = self._jumps(y)
        return np.insert(self.dense.t, jumps, self.dense.t[jumps]), np.insert(y, jumps, np.nan)

    def pair(self, horizontal: MotionQuantity, vertical: MotionQuantity) -> tuple[np.ndarray, np.ndarray]:
        """Two quantities along the interpolated motion, with NaN between where either of them jumps."""
        x, y = (np.asarray(values(self.dense), dtype=float) for values in (horizontal, vertical))
        jumps = np.union1d(self._jumps(x), self._jumps(y))
        return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)

    def _jumps(self, values: np.ndarray) -> np.ndarray:
        """Indices of the samples that begin an interval after a jump of ``values`` (K,)."""
        starts = np.flatnonzero(np.diff(self.dense.solution.interval)) + 1
        finite = values[np.isfinite(values)]
        span = float(np.ptp(finite)) if finite.size else 0.0
        with np.errstate(invalid="ignore"):
            return starts[np.abs(values[starts] - values[starts - 1]) > JUMP * span]

    def at_points(self, values: MotionQuantity) -> tuple[np.ndarray, np.ndarray]:
        """Times and values at the collocation points."""
        rows = self.points.solution.collocation
        return self.points.t[rows], np.asarray(values(self.points), dtype=float)[rows]


def tried(compute: Callable[[], _Result]) -> _Result | None:
    """The result, or None if it cannot be computed, as for a diverged iterate."""
    try:
        with np.errstate(all="ignore"):
            return compute()
    except (TrajoptError, ArithmeticError, ValueError, KeyError):
        return None


def between_points(plan: Solution) -> Solution:
    """The motion at even fractions of every interval, its ends among them; see `solution.interpolation`.

    An interval with non-finite numbers keeps its samples, joined by straight lines.
    """
    count = int(np.clip(round(DRAWN / plan.n_intervals), LEAST, MOST))
    return resampled(plan, np.linspace(0.0, 1.0, count), _interval)


def _interval(plan: Solution, number: int, fractions: np.ndarray) -> MotionSample:
    rows = plan.intervals[number]
    inside = slice(rows.start, rows.stop)
    names = tuple(MotionSample.__dataclass_fields__)
    if all(np.isfinite(getattr(plan, name)[inside]).all() for name in names):
        try:
            return sample_interval(plan, number, fractions)
        except (ArithmeticError, ValueError):  # a diverged iterate: overflow
            pass
    start, end = plan.interval_t[number]
    times = start + fractions * (end - start)
    columns = {name: _straight(times, plan.t[inside], getattr(plan, name)[inside]) for name in names}
    columns["q"] = np.array([pin.normalize(plan.model, row) for row in columns["q"]])
    return MotionSample(**columns)


def _straight(times: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, ...) at ``times`` (n,) on straight lines through ``values`` (k, ...) at ``t`` (k,)."""
    flat = values.reshape(len(t), -1)
    columns = [np.interp(times, t, column) for column in flat.T]
    return np.array(columns).T.reshape(len(times), *values.shape[1:])


def tracks_of(solutions: Sequence[Solution], labels: Sequence[str] | None = None) -> tuple[Track, ...]:
    """Return tracks of solutions of one robot.

    Raises `InputError` for no solution, several robots, or another number of labels.
    """
    if not solutions:
        raise InputError("there is no solution to plot", "allowed: one or more")
    if labels and len(labels) != len(solutions):
        raise InputError(
            f"{len(labels)} labels for {len(solutions)} solutions", "allowed: one label for each, or none"
        )
    for other in solutions[1:]:
        if _robot_of(other) != _robot_of(solutions[0]):
            robots = f"'{solutions[0].description.robot}' and '{other.description.robot}'"
            raise InputError(
                f"{robots} have other joints or contacts",
                "allowed: solutions of one robot",
            )
    names = [str(label) for label in labels] if labels else _labels(solutions)
    return tuple(
        Track(label=label, solution=solution, number=number)
        for number, (label, solution) in enumerate(zip(names, solutions, strict=True))
    )


def _robot_of(solution: Solution) -> tuple[object, ...]:
    """The properties that solutions of one robot share."""
    return list(solution.model.names), solution.contact_frames, solution.q.shape[1], solution.tau.shape[1]


def _labels(solutions: Sequence[Solution]) -> list[str]:
    """Labels that distinguish solutions: simulation or plan, grid and scheme, else numbers."""
    if len(solutions) == 1:
        return [solutions[0].description.problem]
    kinds = ["simulation" if one.statistics.simulated else "plan" for one in solutions]
    grids = [f"{one.n_intervals} x {one.statistics.transcription}" for one in solutions]
    problems = [one.description.problem for one in solutions]
    for names in (kinds, grids, problems, [f"{a}, {b}" for a, b in zip(problems, grids, strict=True)]):
        if len(set(names)) == len(names):
            return names
    return [f"{number + 1}: {grid}" for number, grid in enumerate(grids)]


def title_of(tracks: Sequence[Track]) -> str:
    """Return the names of the problems, and of the robot."""
    names = dict.fromkeys(track.solution.description.problem for track in tracks)
    return f"{', '.join(names)} on {tracks[0].solution.description.robot}"


def state_of(track: Track) -> str:
    """Describe a solution in a line: status, solver and grid."""
    plan, statistics = track.solution, track.solution.statistics
    objective = statistics.objective
    parts = [
        "solved" if statistics.success else f"not solved, {status_of(track)}",
        f"{statistics.solver}, {statistics.iterations} iterations",
        "" if objective is None else f"objective {objective:.6g}",
        f"{statistics.transcription}, {plan.n_intervals} interval{'s' * (plan.n_intervals > 1)}",
        f"{plan.t[-1] - plan.t[0]:.3g} s",
    ]
    return "  \u00b7  ".join(part for part in parts if part)


def failure_of(track: Track) -> str:
    """Say how a solution failed; empty if it did not."""
    failed = not track.solution.success and not track.is_simulated
    parts = [
        f"NOT SOLVED ({status_of(track)}): the last iterate" if failed else "",
        "" if track.is_finite else "NOT FINITE: what is finite is shown",
    ]
    return "; ".join(part for part in parts if part)


def status_of(track: Track) -> str:
    """Return the status of the solver in words."""
    return track.solution.statistics.status.replace("_", " ")
