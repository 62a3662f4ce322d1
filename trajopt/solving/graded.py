"""Solve to a grade: solve on a coarse mesh, check the motion, refine the mesh where it fails, solve again.

The first mesh is of degree four and has two fifths of the problem's intervals, or a quarter on a fixed base;
see `refinement`.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.arguments import Positive, check_settings, checked
from trajopt.certify.accuracy.measures import measure
from trajopt.certify.report import GRADE, Tolerances
from trajopt.errors import InputError, require_positive
from trajopt.motion.grid import mesh_of
from trajopt.motion.input import solution_of
from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.units import Units
from trajopt.solving.exchange import Exchange
from trajopt.solving.feedback import require_gains
from trajopt.solving.refinement import USUAL_SCHEME, Refinement
from trajopt.solving.rounds import Graded, Round, phase_errors
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.transcription.mesh import Mesh
from trajopt.transcription.transcription import chosen_mesh

# Scheme of the first mesh, and its number of intervals as a fraction of the problem's own: on gaits and small
# jumps more accurate than two points on all intervals, in half the time. Fewer suffice on a fixed base; on
# two feet errors grow, and with a quarter of the intervals a dozen gaits are not tracked in MuJoCo.
FIRST_SCHEME, FIRST_PART, FIXED_BASE_PART = "legendre:4", 0.4, 0.25
# Widest interval of the first mesh, in the NLP's unit of time.
WIDEST_INTERVAL = 1.0
MOST_ROUNDS = 14
# The solver's tolerance as a fraction of the accuracy over the robot's reach (the error grows along the
# motion), with its smallest and largest value.
TOLERANCE_SHARE, LEAST_TOLERANCE, USUAL_TOLERANCE = 1e-3, 1e-10, 1e-6
# Target of the next round within a time budget, as a fraction of the last measured error.
GAIN = 0.1
# The next round is expected to take this many times as long as the last: a tenth of the error needs a third
# more intervals at degree four, and phases that miss their target are split in two.
GROWTH = 2.0


def first_mesh(problem: Problem, least: bool = False) -> Mesh:
    """Return the first mesh of a solve to a grade; the problem's own mesh if it names its own scheme.

    With ``least`` the mesh is as coarse as on a fixed base, for refinement by measured errors.
    """
    counts = problem.schedule.intervals(problem.default_intervals)
    if problem.default_transcription != USUAL_SCHEME:
        return Mesh.uniform(problem.default_transcription, counts)
    part = FIXED_BASE_PART if least or problem.robot.base == "fixed" else FIRST_PART
    widest = WIDEST_INTERVAL * Units(problem.robot).time
    wanted = [
        max(round(part * count), math.ceil(phase.duration / widest), 1)
        for count, phase in zip(counts, problem.schedule.phases, strict=True)
    ]
    return Mesh.uniform(FIRST_SCHEME, wanted)


def tolerance_for(accuracy: float, length: float) -> float:
    """Return a solver tolerance far below an ``accuracy`` (m) on a robot with reach ``length`` (m)."""
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
    gains: bool = False,
    **settings: Any,
) -> Solution:
    """Solve a problem until its motion passes the check at all times; never raises if it does not.

    The mesh is refined, see `solve_graded`. A mesh that is given is not refined; a reduced model without legs
    is solved once on its own mesh.

    Args:
        problem: The problem to solve.
        transcription: Scheme of a fixed mesh, as in `trajopt.solving.solving.solve`.
        intervals: Number of its intervals over the whole schedule.
        mesh: The fixed mesh, instead of the two above.
        fixed_mesh: Keep the mesh, which is the problem's own if none is given.
        draft: Stop after one round on the first mesh.
        gains: Give the motion its feedback gains, see `Solution.gains`.
        **settings: Arguments of `trajopt.solving.solving.solve`.

    Returns:
        The best motion. ``success`` is the verdict of the check, ``converged`` says that all rows hold at the
        collocation points. In its statistics ``graded`` has the meshes; ``failures`` and ``advice`` say what
        fails.

    Raises:
        InputError: For a value that is not allowed.
    """
    if fixed_mesh or (transcription, intervals, mesh) != (None, None, None):
        if draft:
            raise InputError("a draft and a mesh are both asked for", "allowed: one of them")
        fixed = chosen_mesh(problem, transcription, intervals, mesh)
        return solve_graded(problem, mesh=fixed, refine=False, gains=gains, **settings).solution
    rounds = 1 if draft else MOST_ROUNDS
    return solve_graded(problem, max_rounds=rounds, gains=gains, **settings).solution


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
    gains: bool = False,
    **settings: Any,
) -> Graded:
    """Solve a problem until its motion is within ``tolerances`` at all times, or refinement ends.

    A reduced model without legs is solved once, on its own mesh, and not checked.

    Args:
        problem: The problem to solve.
        mesh: The first mesh; default: that of ``start``, or `first_mesh`.
        start: Solution, or its file, from which the first solve starts, with collision rows for the pairs
            that had rows there.
        first: Solution of this problem that is checked instead of a first solve.
        exchange: Collision rows of another solve of a similar problem, used from the first solve on.
        tolerances: The grade.
        accuracy: Also bound the error of each phase by this, in m, see `phase_errors`; tightens the solver's
            tolerance as needed.
        max_rounds: Largest number of motions that are checked; with one the result is a draft.
        refine: If False, keep the first mesh and only add collision rows.
        solver_time: Whether the time limit counts only the solver's time.
        gains: Give a motion that converged its feedback gains, see `Solution.gains`.
        **settings: Arguments of `trajopt.solve`; the time limit applies to all solves, guesses and checks
            together, the iteration limit to each solve.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    check_settings(solve_on_mesh, settings)
    if accuracy is not None:
        require_positive("accuracy", accuracy, "m")
        wanted = tolerance_for(accuracy, NaturalUnits.of(problem.robot.model).length)
        settings["tolerance"] = min(settings.get("tolerance", USUAL_TOLERANCE), wanted)
    if gains:
        require_gains(problem)
    if problem.dynamics_kind == "own":
        mesh = mesh or chosen_mesh(problem)
        solution = first or solve_on_mesh(problem, mesh=mesh, start=start, **{**settings, "judge": False})
        rounds = (Round.of(mesh, solution),)
        return Graded(
            solution=solution, examination=None, rounds=rounds, why="its dynamics are its own", examined=0.0
        )
    known = Exchange(problem) if exchange is None else exchange.moved_to(problem)
    if start is not None:
        start = solution_of(start)
        alike = len(start.phases) == len(problem.schedule.phases) and start.model.nq == problem.robot.model.nq
        if alike and exchange is None:
            known.take_up(start)
        if alike and mesh is None:
            mesh = mesh_of(start)
    loop = Refinement(problem, tolerances, refine, settings, known, accuracy, solver_time)
    why = loop.run(mesh or first_mesh(problem, accuracy is not None), start, first, max_rounds)
    return loop.result(why, gains)


@checked
def solve_within(problem: Problem, budget: Positive, **settings: Any) -> Graded:
    """Return the most accurate motion within the grade that the solver finds in a given time.

    The first solve reaches the grade. Each further round refines the mesh for a tenth of the measured error,
    as long as twice the solver time of the last round is left. Building and compiling do not count against
    the budget.

    Args:
        problem: The problem to solve.
        budget: Solver time, s.
        **settings: Arguments of `trajopt.solving.solve_graded` except ``accuracy`` and ``max_time``.

    Returns:
        The motion with its measured error, all rounds, and the reason why they ended.

    Raises:
        InputError: As `trajopt.solve` does.
    """
    settings["solver_time"] = True
    made = solve_graded(problem, max_time=budget, **settings)
    if not made.solution.converged or problem.dynamics_kind == "own":
        return made
    accuracy, why = measure(made.solution), made.why
    rounds = (*made.rounds[:-1], replace(made.rounds[-1], errors=phase_errors(accuracy)))
    made = replace(made, accuracy=accuracy, rounds=rounds)
    for name in ("start", "seed", "perturb", "exchange"):  # only the first solve uses these
        settings.pop(name, None)
    while made.solution.success and not made.interrupted:
        left = budget - sum(one.wall_time for one in rounds)
        if GROWTH * made.rounds[-1].wall_time > left:
            why = "another round is not expected to fit into the time that is left"
            break
        finer = solve_graded(
            problem,
            **{**settings, "max_rounds": 2},
            first=made.solution,
            exchange=made.exchange,
            accuracy=GAIN * made.error,
            max_time=left + made.solution.statistics.wall_time_s,  # the given first round counts against it
        )
        rounds += finer.rounds[1:]
        if not finer.solution.success or finer.error >= made.error:
            why = finer.why
            break
        made = finer
    made = replace(made, rounds=rounds, why=why, target=None)
    graded = replace(made.statistics, error_m=made.error)
    return replace(made, solution=made.solution.with_statistics(graded=graded))
