"""An outcome of a suite, changed as a test needs it."""

from dataclasses import replace
from typing import Any

from trajopt.study.suite.outcome import Attempt, Outcome


def outcome_of(**changes: Any) -> Outcome:
    own = Attempt(
        seed=None, mode="", status="solved", legged=True, scheme="legendre:4", intervals=8, variables=9,
        constraints=8, iterations=40, wall_time=1.5, objective=2.0, figure="drift", used=0.25,
    )  # fmt: skip
    starts = tuple(replace(own, seed=seed, iterations=40 + 10 * seed) for seed in range(10))
    return Outcome(**{"problem": "jump", "robot": "dog", "own": own, "starts": starts, **changes})
