"""Where a diagnosis looks: the NLP of a solution rebuilt at the solution's own unknowns, or a guess."""

from __future__ import annotations

import numpy as np

from trajopt.errors import InputError
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.solving import PreparedProblem
from trajopt.solving.warm_start import warm_start
from trajopt.study.diagnosis.snapshot import Snapshot
from trajopt.transcription.compilation import LEVELS, in_cache
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import Transcription, transcribe


def problem_of(solution: Solution) -> Problem:
    """The problem of the catalogue that a solution names, with its parameters. Raises InputError."""
    from trajopt.problem.catalogue import families

    name, known = str(solution.meta["problem"]), families()
    if name not in known:
        raise InputError(
            f"the file's problem '{name}' is not in the catalogue",
            "allowed: trajopt.diagnose(solution, problem=...) in Python, or --problem NAME",
        )
    family = known[name]
    own = {parameter.name: parameter for parameter in family.parameters}
    given = solution.meta.get("parameters") or {}
    values = {key: value for key, value in given.items() if key in own and value is not None}
    try:
        return family.load(values)
    except InputError:  # a derived value need not be one that may be asked for
        asked = {key: value for key, value in values.items() if own[key].default is not None}
        return family.load(asked)


def cached_level(problem: Problem, mesh: Mesh, level: str) -> str:
    """A few evaluations are no reason to compile: the file's level where it is in the cache, else none."""
    if level not in LEVELS:
        return "none"
    points = {id(group.point): group.point for group in transcribe(problem, mesh=mesh).groups}
    return level if in_cache(points.values(), level) else "none"


def at_solution(prepared: PreparedProblem, solution: Solution) -> Snapshot:
    """The solution's own unknowns, and its multipliers where they are of the same rows."""
    t = prepared.transcription
    found = warm_start(t, solution)
    known = _same_rows(t, solution)
    return Snapshot(
        nlp=prepared.nlp,
        x=found.x,
        row_multiplier=solution.row_multiplier if known else None,
        bound_multiplier=solution.bound_multiplier if known else None,
        tolerance=float(solution.meta["tolerance"]),
    )


def _same_rows(t: Transcription, solution: Solution) -> bool:
    """Whether a solution's multipliers are of this transcription's rows, one by one, and are not all zero."""
    if solution.row_multiplier is None or solution.bound_multiplier is None or solution.row_place is None:
        return False
    if not (solution.row_multiplier.any() or solution.bound_multiplier.any()):
        return False
    places = np.column_stack([t.rows.block, t.rows.stage, t.rows.point])
    return (
        list(solution.meta.get("row_names", ())) == list(t.rows.names)
        and np.array_equal(solution.row_place, places)
        and len(solution.bound_multiplier) == t.layout.n_unknowns
    )
