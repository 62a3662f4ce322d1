"""An outcome of a suite, changed as a test needs it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from trajopt.study.suite.outcome import Attempt, Checked, Grid, Outcome


def outcome_of(**changes: Any) -> Outcome:
    own = Attempt(seed=None, mode="", status="solved", iterations=40, wall_time=1.5, objective=2.0)
    starts = tuple(replace(own, seed=seed, iterations=40 + 10 * seed) for seed in range(10))
    grid = Grid(
        scheme="legendre:2", intervals=30, variables=9, constraints=8, legged=True,
        build_time=0.1, compile_time=0.2,
    )  # fmt: skip
    checked = Checked(ok=True, figure="drift", used=0.25)
    values = {"problem": "jump", "robot": "dog", "grid": grid, "own": own, "check": checked, "starts": starts}
    return Outcome(**{**values, **changes})
