"""Measure the compile levels on one problem: seconds to build and compile, milliseconds to evaluate.

    uv run python -m scripts.compile_levels solo12-jump --level none --level quick

Each level starts with an empty cache folder. Evaluations are the least of many, so that a busy
machine disturbs them little.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable

import click
import numpy as np

from trajopt.solving.solving import prepare
from trajopt.transcription.compilation import CACHE_VARIABLE, LEVELS
from trajopt_library import problems

REPETITIONS = 60
# A step that makes each evaluation point new to the engine, and changes nothing else.
NUDGE = 1e-10


@click.command()
@click.argument("problem")
@click.option("--level", "levels", type=click.Choice(LEVELS), multiple=True, default=("none", "quick"))
@click.option("--transcription", default=None)
def main(problem: str, levels: tuple[str, ...], transcription: str | None) -> None:
    """Print a line for every level."""
    for level in levels:
        with tempfile.TemporaryDirectory() as folder:
            os.environ[CACHE_VARIABLE] = folder
            prepared = prepare(problems.load(problem), transcription=transcription, compile=level)
            engine, x = prepared.nlp.engine, prepared.guess
            lam = np.ones(prepared.transcription.n_rows)
            values = _least(lambda y, engine=engine: engine.f(y), x)
            first = _least(lambda y, engine=engine: engine.jacobian(y), x)
            second = _least(lambda y, engine=engine, lam=lam: engine.hessian(y, 1.0, lam), x)
            report = prepared.compilation
            click.echo(
                f"{level:6s} build {prepared.build_time:5.1f} s  compile {report.compile_time:6.1f} s  "
                f"values {values:.2f} ms  first {first:.2f} ms  second {second:.2f} ms"
            )


def _least(evaluate: Callable[[np.ndarray], object], x: np.ndarray) -> float:
    """Least time of an evaluation in ms."""
    best = np.inf
    for k in range(REPETITIONS):
        point = x + k * NUDGE
        start = time.perf_counter()
        evaluate(point)
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


if __name__ == "__main__":
    main()
