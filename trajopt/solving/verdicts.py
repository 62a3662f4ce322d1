"""Status of a solve: the solver's own, checked against the violations, and failures of the motion itself."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from trajopt._engine import Tape
from trajopt.certify.check import check
from trajopt.certify.report import AT_POINTS, FIGURES, CheckReport, Tolerances
from trajopt.dynamics.virtual_base import LEAST_MARGIN, gimbal_margin_along
from trajopt.errors import TrajoptError
from trajopt.motion.solution import Solution
from trajopt.motion.statistics import TermExcess
from trajopt.solvers.status import Status
from trajopt.transcription.between import rows_between
from trajopt.transcription.transcription import Transcription

# "Solved" is accepted if the recomputed violation of all rows is below this multiple of the tolerance.
TRUSTED_VIOLATION = 10.0
# A solver that fails to find a step with a violation above this (natural units) has found no feasible point.
STILL_FEASIBLE = 1e-3
# Why a solver may not converge at a feasible point: if rows lose rank, multipliers may not exist.
DEPENDENT = (
    "all rows hold, so they may depend on each other there, as of a goal at a singular posture or stated"
    " twice: trajopt diagnose names them"
)
# Statuses of a solve that goes on and on, as without a cost that chooses among motions.
ENDLESS = (Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.STEP_FAILED, Status.UNBOUNDED)
WHEEL = "the shape of a wheel is larger than the ball that rolls, so its edge enters the ground"
WHEEL_REMEDY = "keep the wheel upright, or give its contact the radius of the shape"
COSTLESS = "the problem has no cost, so nothing chooses among its motions: add one, such as AccelerationCost"


def status_by_violation(status: Status, worst: float, tolerance: float) -> Status:
    """Correct the solver's status by the largest violation ``worst`` of any row or bound, natural units."""
    if status is Status.SOLVED and not worst <= TRUSTED_VIOLATION * tolerance:
        return Status.INACCURATE
    if status is Status.STEP_FAILED and not worst <= STILL_FEASIBLE:
        return Status.INFEASIBLE
    return status


def advice_for(status: Status, place: str | None, feasible: bool, costless: bool = False) -> str:
    """Return what to try after a status; ``place`` is where a value is not finite."""
    if costless and status in ENDLESS:
        return "\n".join((status.explain().splitlines()[0], COSTLESS))
    stuck = feasible and status in (Status.STEP_FAILED, Status.ITERATION_LIMIT)
    return status.explain(DEPENDENT if place is None and stuck else place or "")


def certified_infeasible(solution: Solution, why: str) -> Solution:
    """Mark a solution as a point of least violation, see `trajopt.solvers.elastic`; ``why`` is one line."""
    advice = Status.INFEASIBLE.explain(why)
    return solution.with_statistics(advice=advice, certified_infeasible=True)


def fail_on_gimbal_lock(solution: Solution) -> Solution:
    """Mark a solution whose virtual base comes near gimbal lock as failed, whatever the solver says."""
    margin = gimbal_margin_along(solution.model, solution.t, solution.q, solution.v)
    if margin is None:
        return solution
    changes: dict[str, Any] = {"gimbal_margin": finite_or_none(margin)}
    if not margin >= LEAST_MARGIN:
        status = Status.SINGULAR_BASE
        advice = status.explain(f"margin {margin:.3f}, least {LEAST_MARGIN:g}")
        if solution.success:
            changes |= {"status": status.word, "success": False, "converged": False, "advice": advice}
        else:
            changes["advice"] = f"{solution.statistics.advice}; {'; '.join(advice.splitlines())}"
    return solution.with_statistics(**changes)


def judged(solution: Solution, tolerances: Tolerances = AT_POINTS) -> Solution:
    """Judge a converged solution by its check; it is a success only within all tolerances."""
    if not solution.converged:
        return solution
    begun = time.perf_counter()
    try:
        with np.errstate(all="ignore"):
            report = check(solution, integrate=False)
    except (TrajoptError, ArithmeticError, ValueError) as error:
        return _failed(solution, f"the motion cannot be checked\n{error}")
    seconds = time.perf_counter() - begun
    return judged_by(solution.with_statistics(verdict_time_s=seconds), report, tolerances)


def judged_by(solution: Solution, report: CheckReport, tolerances: Tolerances) -> Solution:
    """Judge a converged solution by a given check; the advice names the worst figure and its place.

    The statistics record that figure and its ratio to the tolerance: ``worst_figure``, ``tolerance_used``.
    """
    failures = report.failures(tolerances)
    name, used = report.worst(tolerances)
    solution = solution.with_statistics(
        status=Status.SOLVED.word,
        success=True,
        advice="\n".join(filter(None, [Status.SOLVED.explain(), report.chatter])),
        failures=tuple(failures),
        worst_figure=FIGURES[name].text,
        tolerance_used=finite_or_none(used),
    )
    if not failures:
        return solution
    beyond = f"{report.in_words(name)}, {used:.2g} times what is allowed"
    if name == "link_depth" and _is_of_wheel(solution, str(report.places.get(name))):
        return _failed(solution, f"{WHEEL}\n{beyond}\n{WHEEL_REMEDY}")
    return _failed(solution, Status.COARSE_GRID.explain(beyond))


def _is_of_wheel(solution: Solution, place: str) -> bool:
    """Whether a place of the depth of links is a link that a rolling contact is on."""
    plan, frames = solution.description, solution.model.frames
    joint_of = {frame.name: frame.parentJoint for frame in frames}
    wheels = {joint_of[contact.frame] for contact in plan.contacts if contact.rolling}
    shapes = () if plan.bodies is None else plan.bodies.shapes
    return any(place.startswith(f"{one.name} ") and joint_of.get(one.frame) in wheels for one in shapes)


def _failed(solution: Solution, advice: str) -> Solution:
    return solution.with_statistics(status=Status.COARSE_GRID.word, success=False, advice=advice)


def finite_or_none(value: float) -> float | None:
    """Return the value, or None if it is not finite, for JSON."""
    return value if math.isfinite(value) else None


def terms_between(transcription: Transcription, values: Mapping[int, Tape], x: np.ndarray) -> dict[str, Any]:
    """Return the statistics of terms that a check cannot evaluate, at moments between their points.

    Args:
        transcription: The transcription.
        values: Compiled values of point functions by their id.
        x: Scaled variables (n_unknowns,).
    """
    problem, layout, rows = transcription.problem, transcription.layout, transcription.rows
    terms = (*problem.point_constraints, *problem.node_constraints)
    names = frozenset(term.name for term in terms if not term.in_check)
    times = layout.times(x * transcription.scale)
    by_stage, worst = np.zeros(layout.n_stages), dict[str, TermExcess]()
    for part in rows_between(transcription, values, x, names):
        excess = part.excess(transcription)
        np.maximum.at(by_stage, part.stages, excess.max(axis=1))
        for block in np.unique(rows.block[part.numbers]):
            of_block = excess[:, rows.block[part.numbers] == block].max(axis=1)
            index = int(np.argmax(of_block))
            stage, name = int(part.stages[index]), rows.names[block]
            if name not in worst or of_block[index] > worst[name].excess:
                time = times[stage] + part.fraction * (times[stage + 1] - times[stage])
                phase = layout.schedule.phases[int(layout.phase_of[stage])].name
                worst[name] = TermExcess(
                    term=name, phase=phase, time=float(time), excess=float(of_block[index])
                )
    if not worst:
        return {}
    by_interval = tuple(by_stage[layout.interval_stages].tolist())
    return {"terms_between": tuple(worst.values()), "excess_by_interval": by_interval}
