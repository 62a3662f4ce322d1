"""Why a solve failed, in one word: which of the solver's conditions was not met, or what else happened."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from trajopt.solvers.result import FEASIBILITY_SHARE
from trajopt.solvers.status import Status
from trajopt.solving.verdicts import STILL_FEASIBLE
from trajopt.transcription.violations import describe_block

SOLVED = ""
PRIMAL = "primal"
DUAL = "dual"
COMPLEMENTARITY = "complementarity"
NOT_FINITE = "NaN"
TIME = "time"
CHECK = "check"
ERROR = "error"
MODES = (PRIMAL, DUAL, COMPLEMENTARITY, NOT_FINITE, TIME, CHECK, ERROR)

# What a status says by itself. Diverging iterates are a dual matter: an objective without lower bound has no
# multipliers. A base at gimbal lock and contacts that creep are figures of the check.
_OF_STATUS = {
    Status.SOLVED: SOLVED,
    Status.INFEASIBLE: PRIMAL,
    Status.INACCURATE: PRIMAL,
    Status.UNBOUNDED: DUAL,
    Status.NOT_FINITE: NOT_FINITE,
    Status.TIME_LIMIT: TIME,
    Status.SINGULAR_BASE: CHECK,
    Status.COARSE_GRID: CHECK,
    Status.INVALID: ERROR,
}


def mode_of(meta: Mapping[str, Any]) -> str:
    """The failure mode of a solution's ``meta``, one of `MODES`, or `SOLVED`.

    Where the solver only stopped (iteration limit, no step), the iterate's infeasibilities say why, see
    `worst_condition`.
    """
    status = Status[meta["status"].upper()]
    if status in _OF_STATUS:
        return _OF_STATUS[status]
    share = FEASIBILITY_SHARE if meta["solver"] in ("ipopt", "sqp") else 1.0
    return worst_condition(
        meta["primal_infeasibility"],
        meta["dual_infeasibility"],
        meta["complementarity"],
        meta["tolerance"],
        share * meta["tolerance"],
    )


def failure_text(meta: Mapping[str, Any]) -> str:
    """Status and worst block of a solve that failed, in words; nothing of one that did not."""
    return "" if meta["success"] else f"{meta['status']}: {describe_block(meta['worst_blocks'][0])}"


def worst_condition(
    primal: float | None,
    dual: float | None,
    complementarity: float | None,
    tolerance: float,
    feasibility: float,
) -> str:
    """Which optimality condition an iterate misses most.

    The primal one if rows are violated by more than ``STILL_FEASIBLE``: off the constraints the other two say
    little. Otherwise the one that is most often its tolerance (``feasibility`` for the primal one). None is
    a figure that is not finite.
    """
    figures = [math.nan if value is None else value for value in (primal, dual, complementarity)]
    if not all(math.isfinite(value) for value in figures):
        return NOT_FINITE
    if figures[0] > STILL_FEASIBLE:
        return PRIMAL
    missed = zip(figures, (feasibility, tolerance, tolerance), (PRIMAL, DUAL, COMPLEMENTARITY), strict=True)
    return max(missed, key=lambda entry: entry[0] / entry[1])[2]
