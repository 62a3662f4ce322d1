"""Registry of NLP solvers: what callers must know of each, and one call for all.

A new solver needs one entry in `SOLVERS` and one module with its driver; nothing else names a solver.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from trajopt.errors import InputError
from trajopt.transcription.hessians import EXACT, GAUSS_NEWTON, HESSIANS

if TYPE_CHECKING:  # the command line names the solvers in its help, and loads nothing heavy for that
    import numpy as np

    from trajopt.solvers.result import Callback, Option, Result, StoppingCriteria, WarmMultipliers
    from trajopt.transcription.nlp import Nlp


class Driver(Protocol):
    """Interface of the function that runs a solver."""

    def __call__(
        self,
        nlp: Nlp,
        x0: np.ndarray,
        stop: StoppingCriteria,
        options: Mapping[str, Option],
        callback: Callback,
        warm: WarmMultipliers | None,
    ) -> Result:
        """Solve from scaled variables ``x0``; never raises because the solver did not converge.

        Args:
            nlp: Functions of the problem; its ``transcription`` has bounds, rows and stages.
            x0: Scaled variables (n_unknowns,).
            stop: When to stop; the status says which limit was reached.
            options: Options of the solver.
            callback: Called at each iteration; if it returns False, the solve ends as interrupted.
            warm: Given if ``x0`` comes from another solution, with its multipliers if it has any.

        Raises:
            ValueError: For an unknown option, or a value that is not allowed.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Solver:
    """A solver, and what callers must know of it.

    Args:
        driver: ``module:function`` of its `Driver`, imported on first use.
        hessians: Hessians that it supports.
        feasibility_share: Its tolerance on rows as a fraction of that on optimality.
        certifies_with: Hessians with which its figures reveal a stalled solve, which is then tested for
            infeasibility.
    """

    driver: str
    hessians: tuple[str, ...] = (EXACT, GAUSS_NEWTON)
    feasibility_share: float = 1.0
    certifies_with: tuple[str, ...] = ()

    def load_driver(self) -> Driver:
        """Import and return the driver."""
        module, _, name = self.driver.partition(":")
        driver: Driver = getattr(importlib.import_module(module), name)
        return driver


SOLVERS = {
    # The tolerance on rows is tighter than ``tolerance``, so that a solution passes a check at ``tolerance``.
    "ipopt": Solver(
        driver="trajopt.solvers.ipopt:solve_ipopt",
        hessians=HESSIANS,
        feasibility_share=0.1,
        certifies_with=(EXACT,),
    ),
}


def check_solver(name: str, hessian: str) -> Solver:
    """Return the solver of that name; raises `InputError` for an unknown name or unsupported Hessian."""
    if name not in SOLVERS:
        raise InputError(f"unknown solver '{name}'", f"allowed: {', '.join(SOLVERS)}")
    if hessian not in HESSIANS:
        raise InputError(f"unknown Hessian '{hessian}'", f"allowed: {', '.join(HESSIANS)}")
    solver = SOLVERS[name]
    if hessian not in solver.hessians:
        allowed = f"allowed: {', '.join(solver.hessians)}"
        raise InputError(f"{name} does not take the Hessian '{hessian}'", allowed)
    return solver


def run_solver(
    nlp: Nlp,
    x0: np.ndarray,
    solver: str,
    stop: StoppingCriteria,
    options: Mapping[str, Option],
    callback: Callback,
    warm: WarmMultipliers | None = None,
) -> Result:
    """Solve from ``x0`` with the named solver; arguments as of a `Driver`.

    Raises InputError for an unknown solver or option, and for a Hessian or value that is not supported.
    """
    chosen = check_solver(solver, nlp.hessian)
    stop = replace(stop, feasibility_share=chosen.feasibility_share)
    try:
        return chosen.load_driver()(nlp, x0, stop, options, callback, warm)
    except ValueError as error:
        raise InputError(f"{solver}: {error}") from None
