"""Solve to a grade: solve on a coarse mesh, examine the motion, refine where it misses, solve again from it.

The first mesh has two fifths of the problem's intervals, a quarter on a fixed base, of degree four; see
`refinement`.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.arguments import check_settings, checked
from trajopt.certify.report import GRADE, Tolerances
from trajopt.errors import InputError, require_positive
from trajopt.problem.problem import Problem
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.units import Units
from trajopt.solution.grid import mesh_of
from trajopt.solution.input import solution_of
from trajopt.solution.solution import Solution
from trajopt.solving.exchange import Exchange
from trajopt.solving.refinement import USUAL_SCHEME, Refinement
from trajopt.solving.rounds import Graded, Round
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import chosen_mesh

# Scheme of the first mesh, and its part of the problem's own intervals: on gaits and small jumps more
# accurate than two points on all of them, in half the time. On a fixed base fewer do: errors of a stance on
# two feet grow, and with a quarter of the intervals a dozen gaits are not tracked in MuJoCo.
FIRST_SCHEME, FIRST_PART, FIXED_BASE_PART = "legendre:4", 0.4, 0.25
# Widest interval of the first mesh, in the NLP's scale of time.
WIDEST = 1.0
MOST_ROUNDS = 10
# The solver's tolerance, as a fraction of an accuracy over the robot's reach, and its least: the error grows
# along the motion.
TOLERANCE_SHARE, LEAST_TOLERANCE, USUAL_TOLERANCE = 1e-3, 1e-10, 1e-6


def first_mesh(problem: Problem, least: bool = False) -> Mesh:
    """The mesh on which a solve to a grade begins; that of the problem where it names a scheme of its own.

    least: as coarse as on a fixed base, for what is refined by measurement.
    """
    counts = problem.schedule.intervals(problem.default_intervals)
    if problem.default_transcription != USUAL_SCHEME:
        return Mesh.uniform(problem.default_transcription, counts)
    part = FIXED_BASE_PART if least or problem.robot.base == "fixed" else FIRST_PART
    widest = WIDEST * Units(problem.robot).time
    wanted = [
        max(round(part * count), math.ceil(phase.duration / widest), 1)
        for count, phase in zip(counts, problem.schedule.phases, strict=True)
    ]
    return Mesh.uniform(FIRST_SCHEME, wanted)


def tolerance_for(accuracy: float, length: float) -> float:
    """A solver's tolerance that leaves a small part of ``accuracy`` (m) on a robot of reach ``length``."""
    return float(np.clip(TOLERANCE_SHARE * accuracy / length, LEAST_TOLERANCE, USUAL_TOLERANCE))


@checked
def solve(
    problem: Problem,
    *,
    transcription: str | None = None,
    intervals: int | None = None,
    mesh: Mesh | None = None,
    fixed_mesh: bool = False,
    draft: bool = False,
    **settings: Any,
) -> Solution:
    """Solve a problem until its motion holds at any time; never raises because that is not reached.

    The mesh is refined, see `solve_graded`. A mesh that is named is solved once, like that of a reduced model
    without legs.

    Args:
        problem: What to solve.
        transcription: Scheme of a mesh to solve on once, as in `trajopt.solving.solving.solve`.
        intervals: Its number of intervals over the whole schedule.
        mesh: That mesh, instead of both.
        fixed_mesh: Solve once, on the problem's own mesh where none is named.
        draft: Solve once, on the first mesh of a refinement.
        **settings: Those of `trajopt.solving.solving.solve`.

    Returns:
        The best motion. Its ``success`` is the verdict of the check, ``converged`` that all rows hold at its
        points; its statistics have in ``graded`` the meshes, in ``failures`` and ``advice`` what is missed.

    Raises:
        InputError: For a value that is not allowed.
    """
    if fixed_mesh or (transcription, intervals, mesh) != (None, None, None):
        if draft:
            raise InputError("a draft and a mesh are both asked for", "allowed: one of them")
        fixed = chosen_mesh(problem, transcription, intervals, mesh)
        return solve_graded(problem, mesh=fixed, refine=False, **settings).solution
    return solve_graded(problem, max_rounds=1 if draft else MOST_ROUNDS, **settings).solution


def solve_graded(
    problem: Problem,
    *,
    mesh: Mesh | None = None,
    start: Solution | str | Path | None = None,
    first: Solution | None = None,
    exchange: Exchange | None = None,
    tolerances: Tolerances = GRADE,
    accuracy: float | None = None,
    max_rounds: int = MOST_ROUNDS,
    refine: bool = True,
    solver_time: bool = False,
    **settings: Any,
) -> Graded:
    """Solve a problem until its motion is within ``tolerances`` at any time, or no mesh is left to try.

    A reduced model without legs is solved once, on its own mesh, and not examined.

    Args:
        problem: What to solve.
        mesh: The first one; default: that of ``start``, or `first_mesh`.
        start: A solution, or its file, from which the first solve starts, with rows for the bodies that rows
            kept apart there.
        first: A solution of this problem, examined instead of a first solve.
        exchange: Rows for bodies of another solve of such a problem, which the first solve has already.
        tolerances: The grade.
        accuracy: Largest error of a phase besides, m, and the solver's tolerance by it; see `phase_errors`.
        max_rounds: Limit of motions that are solved for and examined; one is a draft.
        refine: False keeps the first mesh: only rows for bodies that come too near are added.
        solver_time: Whether the limit of time is one of the solver's time alone.
        **settings: Those of `trajopt.solve`; the limit of time is for all solves, with their guesses and
            checks, that of iterations for each.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    check_settings(solve_on_mesh, settings)
    if accuracy is not None:
        require_positive("accuracy", accuracy, "m")
        wanted = tolerance_for(accuracy, NaturalUnits.of(problem.robot.model).length)
        settings["tolerance"] = min(settings.get("tolerance", USUAL_TOLERANCE), wanted)
    if not problem.holds_contacts:
        mesh = mesh or chosen_mesh(problem)
        solution = first or solve_on_mesh(problem, mesh=mesh, start=start, **{**settings, "judge": False})
        rounds = (Round.of(mesh, solution),)
        return Graded(solution=solution, examination=None, rounds=rounds, why="it has no legs", examined=0.0)
    known = Exchange(problem) if exchange is None else exchange.moved_to(problem)
    if start is not None:
        start = solution_of(start)
        alike = len(start.phases) == len(problem.schedule.phases) and start.model.nq == problem.robot.model.nq
        if alike and exchange is None:
            known.take_up(start)
        if alike and mesh is None:
            mesh = mesh_of(start)
    loop = Refinement(problem, tolerances, refine, settings, known, accuracy, solver_time)
    return loop.result(loop.run(mesh or first_mesh(problem, accuracy is not None), start, first, max_rounds))
