"""The gain of compiling, and how much timed processes on separate cores disturb each other."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

from scripts.measure.shared import head, row
from trajopt.solving.solving import prepare
from trajopt.study.sweep.cores import physical_cores
from trajopt.study.sweep.engine import MODULES
from trajopt.study.sweep.plan import own_setting
from trajopt.study.sweep.records import SweepRequest
from trajopt.study.sweep.result import Job, TimedRun
from trajopt.study.sweep.run import run_job
from trajopt.study.workers.executor import ProcessPerTaskExecutor
from trajopt.study.workers.task import announced
from trajopt.transcription.c_compiler import FLAGS
from trajopt.transcription.cache_entries import CACHE_VARIABLE
from trajopt_library import problems

REPETITIONS = 60
# A step that makes each evaluation point new to the engine, and is otherwise negligible.
NUDGE = 1e-10
LIMIT = 600.0
FIGURES = ("wall_time", "function_time", "calibration")


@click.command()
@click.argument("problem")
@click.option("--level", "levels", type=click.Choice(tuple(FLAGS)), multiple=True, default=("none", "quick"))
def compilation(problem: str, levels: tuple[str, ...]) -> None:
    """Compile levels: time to build and compile with an empty cache, least time of an evaluation."""
    head("level", "build", "compile", "values", "first derivatives", "second derivatives")
    for level in levels:
        with tempfile.TemporaryDirectory() as folder:
            os.environ[CACHE_VARIABLE] = folder
            prepared = prepare(problems.load(problem), compile=level)
            engine, lam = prepared.nlp.engine, np.ones(prepared.transcription.n_rows)
            evaluations = (engine.f, engine.jacobian, lambda x, e=engine, lam=lam: e.hessian(x, 1.0, lam))
            each = [f"{_least(evaluate, prepared.guess):.2f} ms" for evaluate in evaluations]
            row(level, f"{prepared.build_time:.1f} s", f"{prepared.compilation.compile_time:.1f} s", *each)


def _least(evaluate: Callable[[np.ndarray], object], x: np.ndarray) -> float:
    """Least time of an evaluation in ms."""
    best = np.inf
    for k in range(REPETITIONS):
        point = x + k * NUDGE
        start = time.perf_counter()
        evaluate(point)
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


@click.command()
@click.argument("problem", default="solo12-jump")
@click.option("--repeats", default=15, show_default=True, help="Runs alone, and together.")
def pinned(problem: str, repeats: int) -> None:
    """Medians of one pinned solve alone and on all cores at once, in turn."""
    click.echo("\n".join(disturbance(problem, repeats)))


def disturbance(problem: str, repeats: int) -> list[str]:
    """Medians of the solver's time, the functions' and the calibration beside it, alone and together."""
    request, cores = SweepRequest(problem=problem), physical_cores()
    setting = own_setting(request.load())
    job = Job(setting=setting.name, start=0)
    alone: list[TimedRun] = []
    together: list[TimedRun] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPerTaskExecutor(len(cores), cores=cores, preload=MODULES) as executor,
    ):

        def run(count: int) -> list[TimedRun]:
            tasks = [
                (announced, str(k), LIMIT, run_job, request, setting, job, Path(folder) / f"{k}.npz")
                for k in range(count)
            ]
            futures = [executor.submit(*task) for task in tasks]
            return [future.result() for future in futures]

        run(len(cores))  # compiles where the cache is empty
        for _ in range(repeats):
            alone += run(1)
            together += run(len(cores))
    lines = [f"{problem}, {setting.name}; {len(cores)} cores, {repeats} repeats"]
    for name in FIGURES:
        one, all_ = (statistics.median(getattr(run, name) for run in runs) for runs in (alone, together))
        lines.append(f"{name:14} alone {1e3 * one:8.2f} ms, together {1e3 * all_:8.2f} ms: {all_ / one:.3f}")
    return lines
