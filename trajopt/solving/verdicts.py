"""Status of a solve: the solver's, checked against the violations, and failures of the motion itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from trajopt.certify.contact_figures import ContactStarts, place_traces
from trajopt.certify.samples import contact_places
from trajopt.dynamics.virtual_base import LEAST_MARGIN, gimbal_margin_along
from trajopt.solution.solution import Solution
from trajopt.solution.touched import touched_surfaces
from trajopt.solvers.status import Status

# A solver's "solved" is believed up to this multiple of its tolerance, measured anew on all rows.
TRUSTED_VIOLATION = 10.0
# A solver that finds no step this far from feasible (natural units) has found no feasible point.
STILL_FEASIBLE = 1e-3
# Why a solver may not converge at a feasible point: where rows lose rank there are no multipliers.
DEPENDENT = (
    "; all rows hold at this iterate, so they may depend on each other there, as of a goal at a singular"
    " posture or the same goal stated twice: trajopt diagnose names them"
)
# A solved motion whose contacts move by more than this part of the robot's length within a phase has failed:
# its grid is too coarse to hold them. What `check` allows is far less.
MOST_CREEP = 0.25


def status_by_violation(status: Status, worst: float, tolerance: float) -> Status:
    """The solver's status, by the largest violation ``worst`` of any row or bound, in natural units."""
    if status is Status.SOLVED and not worst <= TRUSTED_VIOLATION * tolerance:
        return Status.INACCURATE
    if status is Status.STEP_FAILED and not worst <= STILL_FEASIBLE:
        return Status.INFEASIBLE
    return status


def advice_for(status: Status, place: str | None, feasible: bool) -> str:
    """Return what to try after a status; ``place``: of a value that is not finite."""
    if place is not None:
        return f"{status.advice}: {place}"
    stuck = feasible and status in (Status.STEP_FAILED, Status.ITERATION_LIMIT)
    return f"{status.advice}{DEPENDENT}" if stuck else status.advice


def fail_on_gimbal_lock(solution: Solution) -> Solution:
    """Mark a solution whose virtual base comes near gimbal lock as failed, whatever the solver says."""
    margin = gimbal_margin_along(solution.model, solution.t, solution.q, solution.v)
    if margin is None:
        return solution
    found: dict[str, Any] = {"gimbal_margin": finite_or_none(margin)}
    if not margin >= LEAST_MARGIN:
        status = Status.SINGULAR_BASE
        found["advice"] = f"{status.advice} (margin {margin:.3f}, least {LEAST_MARGIN:g})"
        if solution.success:
            found |= {"status": status.word, "success": False}
        else:
            found["advice"] = f"{solution.meta['advice']}; {found['advice']}"
    return replace(solution, meta={**solution.meta, **found})


def fail_on_contact_drift(solution: Solution, length: float) -> Solution:
    """Mark a solution as failed if its contacts drift by a large fraction of the robot's ``length`` in m."""
    if not solution.success:
        return solution
    places = contact_places(solution)
    surfaces = touched_surfaces(solution, places.position)
    starts = ContactStarts.of(solution, places, surfaces)
    found = place_traces(solution, places, surfaces, starts)["foot_drift"].worst()
    creep = 0.0 if found is None else found[0]
    if creep <= MOST_CREEP * length:
        return solution
    status = Status.COARSE_GRID
    advice = f"{status.advice} (by {creep:.2g} m, most {MOST_CREEP * length:.2g} m)"
    return replace(
        solution, meta={**solution.meta, "status": status.word, "success": False, "advice": advice}
    )


def is_usable_start(solution: Solution) -> bool:
    """Whether another solve can start from it: all rows hold, if only at the points of a coarse grid."""
    return solution.success or solution.meta["status"] == Status.COARSE_GRID.word


def finite_or_none(value: float) -> float | None:
    """The value, or None where it is not finite, as JSON wants it."""
    return value if math.isfinite(value) else None
