"""What a cell of the matrix of extremes must come to, and the one function that holds it to that.

A cell is a problem (a function that builds it) and the settings of its solve. It runs in a process of its own
that is killed after a hard limit, so that a cell that hangs or crashes fails like any other:

    assert_outcome(Solved(open_loop=1e-3), partial(problems.load, "ur5-reach"), transcription="radau:1")
    assert_outcome(Refused("gravity"), lambda: weightless_jump())
    assert_outcome(Failed(Status.INFEASIBLE, block="friction_pyramid"), lambda: pushed_sideways(friction=0.0))

`assert_outcome` returns the solution (None where it was refused), for what a test has to say beyond it.
"""

import json
import multiprocessing
import re
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from trajopt import InputError, Problem, Solution, TrajoptError, check
from trajopt.certify.report import AT_POINTS, CheckReport
from trajopt.cli.report import solve_dict, solve_summary, to_json
from trajopt.errors import SolutionFileError
from trajopt.motion.consistency import OTHERS, SAMPLED
from trajopt.solvers.status import Status
from trajopt.solving.solving import solve

# Seconds after which the process of a cell is killed: several times what the longest takes on a busy machine.
HARD_LIMIT = 180.0
# Seconds after which a solver stops by itself: a cell that needs as long has failed.
SOLVER_LIMIT = 90.0


@dataclass(frozen=True)
class Solved:
    """Success, every figure that `check` judges within its tolerance, and open loop within a bound.

    open_loop: largest error of any phase, integrated from its planned start by numeric Pinocchio with the
    planned torques alone: metres over the robot's length, radians, joints in rad or m; None does not ask.
    coarse: where the cell's grid is too coarse for what `check` allows feet to creep, hover and sink between
    points, the bound on these instead, m.
    """

    open_loop: float | None
    coarse: float | None = None


@dataclass(frozen=True)
class Refused:
    """InputError of one line that matches ``cause`` (a regular expression) and says what is allowed."""

    cause: str


class Failed:
    """No success, one of these statuses, advice, and the worst rows: ``block`` among the three named."""

    def __init__(self, *statuses: Status, block: str | None = None, advice: str = "") -> None:
        self.statuses, self.block, self.advice = statuses, block, advice


Expected = Solved | Refused | Failed


class CellError(AssertionError):
    """A cell did not come to what is expected of it."""


def assert_outcome(
    expected: Expected, make: Callable[[], Problem], *, hard_limit: float = HARD_LIMIT, **settings: Any
) -> Solution | None:
    """Build and solve in another process, hold the outcome to what is expected, return the solution.

    settings: as `trajopt.solving.solve` takes them; without compilation unless they say otherwise.
    Raises CellError.
    """
    settings = {"max_time": SOLVER_LIMIT, **settings}
    found = in_process(lambda: _cell(expected, make, settings), hard_limit)
    if isinstance(found, str):
        print(found)
        return None
    solution, line = found
    print(line)
    return solution


def in_process(work: Callable[[], Any], limit: float = HARD_LIMIT) -> Any:
    """What ``work()`` returns in a fork of this process, killed after ``limit`` s. Raises CellError."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_told, args=(work, sender), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # a fork beside BLAS' own idle threads
        process.start()
    sender.close()
    try:
        if not receiver.poll(limit):
            raise CellError(f"hangs: killed after {limit:g} s")
        good, value = receiver.recv()
    except EOFError:
        process.join(limit)
        raise CellError(f"its process crashed: exit code {process.exitcode}") from None
    finally:
        process.kill()
        process.join(limit)
    if not good:
        raise CellError(value)
    return value


def _told(work: Callable[[], Any], sender: Connection) -> None:
    try:
        sender.send((True, work()))
    except CellError as error:
        sender.send((False, str(error)))
    except BaseException:
        sender.send((False, traceback.format_exc()))


def _cell(expected: Expected, make: Callable[[], Problem], settings: dict[str, Any]) -> Any:
    try:
        problem = make()
        solution = solve(problem, **settings)
    except InputError as error:
        _require(isinstance(expected, Refused), f"refused: {error}")
        return _refusal(expected, error)
    _require(not isinstance(expected, Refused), f"not refused: {solution.statistics.status}")
    report = _report(solution)
    _require_sound(solution, report)
    if isinstance(expected, Solved):
        _require_solved(expected, problem, solution, report)
    elif isinstance(expected, Failed):
        _require_failed(expected, solution)
    return solution, _line(problem, solution, report)


def _refusal(expected: Expected, error: InputError) -> str:
    text = str(error)
    assert isinstance(expected, Refused)
    _require(re.search(expected.cause, text) is not None, f"refused for another cause: {text}")
    _require("\n" not in text.strip(), f"refused in more than one line: {text}")
    _require(bool(error.allowed), f"refused without saying what is allowed: {text}")
    return f"refused: {text}"


def _require_sound(solution: Solution, report: CheckReport | None) -> None:
    """What holds of every solution, solved or not: JSON without NaN, a status with advice, the same file."""
    statistics = solution.statistics
    json.dumps(json.loads(to_json(solution.meta)), allow_nan=False)
    printed = solve_summary(solution, report, None, [])
    for text in (to_json(solve_dict(solution, report, None)), printed, to_json(solution.meta)):
        _require(re.search(r"\bnan\b", text, re.IGNORECASE) is None, f"NaN is passed on: {text}")
    status = Status[statistics.status.upper()]
    _require(
        statistics.success == (status is Status.SOLVED),
        f"success {statistics.success} with {statistics.status}",
    )
    _require(
        statistics.advice.startswith(status.explain()[:20]),
        f"advice of {statistics.status}: {statistics.advice}",
    )
    finite = all(
        np.isfinite(getattr(solution, name)).all()
        for name, kind in {**SAMPLED, **OTHERS}.items()
        if kind is float and getattr(solution, name) is not None
    )
    _require(finite or not statistics.success, "success with a NaN")
    _require(finite or report is None, "a solution with a NaN was checked")
    _require_file(solution, report, finite)


def _require_file(solution: Solution, report: CheckReport | None, finite: bool) -> None:
    """What is saved and loaded is the same and checks the same; what is not finite is not saved at all."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cell.npz"
        try:
            loaded = Solution.load(solution.save(file))
        except (InputError, SolutionFileError) as error:
            _require(not finite, f"a finite solution cannot be saved: {error}")
            _require(not file.exists(), "a file was written all the same")
            return
    _require(finite, "a NaN is written to a file")
    for name in SAMPLED:
        same = np.array_equal(getattr(loaded, name), getattr(solution, name))
        _require(same, f"'{name}' is not the same after it was saved and loaded")
    if report is not None and solution.n_intervals <= RECHECKED:
        _require(check(loaded).to_dict() == report.to_dict(), "the loaded solution checks differently")


# A second check of a long solution costs as much as the first and says as little as of a short one.
RECHECKED = 60


def _report(solution: Solution) -> CheckReport | None:
    """The independent check; None for an iterate that is no motion, which the check refuses."""
    try:
        with np.errstate(all="ignore"):
            return check(solution)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        _require(not solution.success, f"a success that cannot be checked: {error}")
        return None


def _require_solved(
    expected: Solved, problem: Problem, solution: Solution, report: CheckReport | None
) -> None:
    statistics = solution.statistics
    _require(solution.converged, f"{statistics.status} ({statistics.advice}): {statistics.worst_blocks[:1]}")
    assert report is not None
    tolerances = AT_POINTS
    if expected.coarse is not None:
        tolerances = replace(tolerances, foot_drift=expected.coarse, penetration=expected.coarse)
    failures = [f"{name} {getattr(report, name):.2e}" for name in report.failures(tolerances)]
    _require(not failures, f"wrong success: {', '.join(failures)}")
    error = open_loop(problem, report)
    if expected.open_loop is not None:
        _require(error <= expected.open_loop, f"open loop {error:.2e} beyond {expected.open_loop:.0e}")


def _require_failed(expected: Failed, solution: Solution) -> None:
    statistics = solution.statistics
    _require(not solution.success, "success where a failure is expected")
    words = [status.word for status in expected.statuses]
    _require(
        statistics.status in words,
        f"{statistics.status} instead of {' or '.join(words)}: {statistics.advice}",
    )
    named = [entry["block"] for entry in statistics.worst_blocks]
    _require(bool(named), "no rows are named")
    if expected.block is not None:
        _require(expected.block in named, f"'{expected.block}' is not among the worst rows {named}")
    _require(expected.advice in statistics.advice, f"advice without '{expected.advice}': {statistics.advice}")


def open_loop(problem: Problem, report: CheckReport) -> float:
    """Worst open-loop error of any phase: position over the robot's length, orientation, joints."""
    position = (report.open_loop_position or 0.0) / problem.robot.length
    return max(position, report.open_loop_orientation or 0.0, report.open_loop_joints)


def _line(problem: Problem, solution: Solution, report: CheckReport | None) -> str:
    """The cell's figures in one line: what docs/extremes.md shows."""
    statistics = solution.statistics
    figures = [statistics.status, f"{statistics.iterations} iterations"]
    if report is not None:
        figures.append(f"open loop {open_loop(problem, report):.1e}")
    if statistics.max_violation is not None:
        figures.append(f"violation {statistics.max_violation:.1e}")
    if report is not None and report.foot_drift is not None:
        figures.append(f"feet off by {max(report.foot_drift, report.penetration or 0.0):.1e} m")
    return f"{problem.name} on {problem.robot.name}: {', '.join(figures)}"


def _require(true: bool, otherwise: str) -> None:
    if not true:
        raise CellError(otherwise)
