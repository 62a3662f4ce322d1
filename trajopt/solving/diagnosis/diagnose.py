"""Diagnose a solution: rebuild its NLP, analyse it at the iterate, and report in words."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError, TrajoptError
from trajopt.motion.grid import mesh_of
from trajopt.motion.input import solution_of
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families
from trajopt.problem.problem import Problem
from trajopt.solving.diagnosis.activity import active_limits
from trajopt.solving.diagnosis.advice import advice
from trajopt.solving.diagnosis.conflict import conflict
from trajopt.solving.diagnosis.contacts import phase_contacts
from trajopt.solving.diagnosis.diagnosis import Diagnosis, Violation
from trajopt.solving.diagnosis.findings import curvature_report, rank_report, start_findings
from trajopt.solving.diagnosis.nonfinite import first_nonfinite
from trajopt.solving.diagnosis.scaling import scaling
from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.solving.extraction import extract
from trajopt.solving.solving import PreparedProblem, prepare
from trajopt.solving.verdicts import STILL_FEASIBLE, finite_or_none
from trajopt.solving.warm_start import warm_start
from trajopt.transcription.transcription import Transcription

# Rows are violated beyond this multiple of the solve's tolerance.
TRUSTED_MULTIPLE = 10.0
WORST_ROWS = 5
# Largest difference of objective and violation between a file and the problem rebuilt from it.
AGREEMENT = 1e-4


@checked
def diagnose(
    what: Solution | PreparedProblem | str | Path,
    problem: Problem | None = None,
    *,
    robot: str | None = None,
) -> Diagnosis:
    """Diagnose an NLP at an iterate.

    Args:
        what: A solution or its file, solved or not; or a prepared problem, which is diagnosed at its guess.
        problem: Problem of the solution; default: the catalogue's, by the name and parameters in the file.
        robot: Name or ``.py`` file of the problem's robot; default: the catalogue robot that the file names.
            A robot file named in a solution is not executed.

    Raises:
        InputError: If the problem is unknown, or its robot or phases differ from the solution's.
    """
    if isinstance(what, PreparedProblem):
        return _diagnosed(
            Snapshot(nlp=what.nlp, x=what.guess), None, f"guess of {what.transcription.problem.name}"
        )
    solution = solution_of(what)
    source = str(what) if isinstance(what, str | Path) else "solution"
    rebuilt = _problem_of(solution, robot) if problem is None else problem
    planned = solution.description.robot
    if planned != rebuilt.robot.name:
        raise InputError(
            f"problem '{rebuilt.name}' is on robot '{rebuilt.robot.name}', and {source} on '{planned}'",
            f"allowed: a problem on robot {planned}",
        )
    prepared = prepare(rebuilt, mesh=mesh_of(solution))
    return _diagnosed(at_solution(prepared, solution), solution, source)


def _problem_of(solution: Solution, robot: str | None) -> Problem:
    """Return the catalogue problem that a solution names, with its parameters. Raises InputError."""
    name, known = str(solution.description.problem), families()
    if name not in known:
        raise InputError(
            f"the file's problem '{name}' is not in the catalogue",
            "allowed: with `problem=...`",
        )
    family = known[name]
    parameters = {parameter.name: parameter for parameter in family.parameters}
    stated = dict(solution.description.parameters)
    if robot is not None:
        stated.pop("robot", None)
    values = family.of_file(stated) | ({} if robot is None else {"robot": robot})
    try:
        return family.load(values)
    except InputError:  # a derived value may be out of range
        asked = {key: value for key, value in values.items() if parameters[key].default is not None}
        return family.load(asked)


def at_solution(prepared: PreparedProblem, solution: Solution) -> Snapshot:
    """Return the NLP at the solution, with multipliers if they belong to the same rows."""
    t = prepared.transcription
    start = warm_start(t, solution)
    known = _same_rows(t, solution)
    return Snapshot(
        nlp=prepared.nlp,
        x=start.x,
        row_multiplier=solution.row_multiplier if known else None,
        bound_multiplier=solution.bound_multiplier if known else None,
        tolerance=float(solution.statistics.tolerance),
    )


def _same_rows(t: Transcription, solution: Solution) -> bool:
    """Return whether a solution's multipliers belong to the transcription's rows and are not all zero."""
    if solution.row_multiplier is None or solution.bound_multiplier is None or solution.row_place is None:
        return False
    if not (solution.row_multiplier.any() or solution.bound_multiplier.any()):
        return False
    places = np.column_stack([t.rows.block, t.rows.stage, t.rows.point])
    return (
        solution.statistics.row_names == tuple(t.rows.names)
        and np.array_equal(solution.row_place, places)
        and len(solution.bound_multiplier) == t.layout.n_unknowns
    )


def _diagnosed(snapshot: Snapshot, solution: Solution | None, source: str) -> Diagnosis:
    t = snapshot.transcription
    finite = snapshot.finite
    near = bool(snapshot.violations.max(initial=0.0) <= STILL_FEASIBLE)
    count = len(t.layout.schedule.phases)
    phases = range(count) if count > 1 else ()
    judged = snapshot if near else snapshot.structure
    worst = _worst(snapshot, TRUSTED_MULTIPLE * snapshot.tolerance)
    largest = float(snapshot.violations.max(initial=0.0)) if np.isfinite(snapshot.violations).all() else None
    statistics = None if solution is None else solution.statistics
    motion = extract(t, snapshot.x) if solution is None else solution
    diagnosis = Diagnosis(
        problem=t.problem.name,
        robot=t.problem.robot.name,
        source=source,
        status=None if statistics is None else statistics.status,
        solved=statistics is not None and statistics.converged,
        variables=t.layout.n_unknowns,
        constraints=t.n_rows,
        max_violation=largest,
        stationarity=snapshot.stationarity if finite else None,
        worst=tuple(worst),
        nonfinite=None if finite else first_nonfinite(snapshot.nlp, snapshot.names, snapshot.x),
        ranks=tuple(rank_report(judged, phase) for phase in (None, *phases)) if finite else (),
        contacts=tuple(phase_contacts(t, motion)),
        curvature=curvature_report(judged) if finite else None,
        scaling=scaling(snapshot) if finite else None,
        limits=tuple(active_limits(snapshot)) if finite else (),
        conflict=conflict(snapshot) if finite and worst else None,
        local_error=_local_errors(solution) if solution is not None and solution.converged else None,
        start=tuple(start_findings(t.problem)),
        notes=tuple(_notes(snapshot, solution, largest)),
    )
    return replace(diagnosis, advice=tuple(advice(diagnosis)))


def _worst(snapshot: Snapshot, limit: float) -> list[Violation]:
    """Return the worst violated rows and bounds, one for each block."""
    names = snapshot.names
    amounts = np.where(np.isfinite(snapshot.violations), snapshot.violations, np.inf)
    worst: dict[str, Violation] = {}
    for index in np.argsort(-amounts, kind="stable")[: np.count_nonzero(amounts > limit)].tolist():
        block = names.block(index)
        if block not in worst and len(worst) < WORST_ROWS:
            worst[block] = Violation(
                row=names.row_text(index),
                block=block,
                phase=names.phase(names.sites[index].stage),
                amount=finite_or_none(float(amounts[index])),
            )
    return list(worst.values())


def _local_errors(solution: Solution | None) -> dict[str, float] | None:
    """Return the largest error of an interval by phase, m, or None if re-integration fails."""
    from trajopt.certify.accuracy.measures import interval_errors

    if solution is None:
        return None
    try:
        with np.errstate(all="ignore"):
            errors = interval_errors(solution)
    except (TrajoptError, ArithmeticError, ValueError):
        return None
    names = solution.description.phase_names or [str(i) for i in range(len(solution.phases))]
    return {
        str(name): float(np.max(errors[np.unique(solution.interval[list(rows)])]))
        for name, rows in zip(names, solution.phases, strict=True)
    }


def _notes(snapshot: Snapshot, solution: Solution | None, largest: float | None) -> Iterator[str]:
    """Yield indications that the rebuilt problem is not the one from which the file was made."""
    if solution is None:
        return
    unit = snapshot.transcription.objective_unit
    before, now = solution.statistics.objective, unit * float(snapshot.nlp.engine.f(snapshot.x))
    if before is not None and math.isfinite(now) and abs(now - before) > AGREEMENT * max(1.0, abs(before)):
        yield f"the rebuilt problem's objective is {now:.6g} here, the file says {before:.6g}: they differ"
    stated = solution.statistics.max_violation
    if stated is not None and largest is not None and abs(largest - stated) > AGREEMENT * max(1.0, stated):
        yield f"the rebuilt problem's rows miss {largest:.2e} here, the file says {stated:.2e}: they differ"
    if solution.converged and snapshot.complementarity > AGREEMENT:
        yield (
            f"multipliers do not fit the slacks of the rebuilt problem's limits "
            f"({snapshot.complementarity:.1e}): the problem has changed since the file was made"
        )
    if solution.converged and snapshot.row_multiplier is None:
        yield "the file has no multipliers of these rows: limits and curvature are judged without them"
