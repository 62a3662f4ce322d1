"""What tapes cost and gain, and how much timed processes on separate cores disturb each other."""

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import click
import numpy as np

from scripts.measure.shared import head, row
from trajopt import _engine
from trajopt.cache import CACHE_VARIABLE
from trajopt.cli.input import parse_settings
from trajopt.solving.solving import prepare
from trajopt.study.processes import ProcessPerTaskExecutor
from trajopt.study.sweep.engine import MODULES, physical_cores
from trajopt.study.sweep.plan import own_setting
from trajopt.study.sweep.records import Job, SweepRequest, TimedRun
from trajopt.study.sweep.run import run_job
from trajopt.study.tasks import limited
from trajopt.transcription.stage_functions import Derivatives
from trajopt_library import problems

REPETITIONS = 60
# At once, in the time of a tape.
POINTS = 64
# A step that makes each evaluation point new to the engine, and is otherwise negligible.
NUDGE = 1e-10
LIMIT = 600.0
FIGURES = ("wall_time", "function_time", "calibration")


@click.command()
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of the problem.")
def compilation(problem: str, settings: tuple[str, ...]) -> None:
    """Time to differentiate and compile with an empty cache, and of an evaluation by tapes and by CasADi."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder
        prepared = prepare(problems.load(problem, **parse_settings(settings, "--set")))
        engine, lam = prepared.nlp.engine, np.ones(prepared.transcription.n_rows)
        evaluations = (engine.f, engine.jacobian, lambda x: engine.hessian(x, 1.0, lam))
        size = sum(file.stat().st_size for file in Path(folder).iterdir())
    report = prepared.compilation
    click.echo(
        f"{report.built} functions: differentiated in {report.build_time:.2f} s, compiled in "
        f"{report.compile_time:.2f} s, {size / 1e6:.1f} MB"
    )
    each = [f"{_least(evaluate, prepared.guess):.2f} ms" for evaluate in evaluations]
    click.echo(f"all points: values {each[0]}, first derivatives {each[1]}, second derivatives {each[2]}")
    head("function of the largest point", "operations", "statements", "CasADi's virtual machine", "tape")
    graphs = [Derivatives(point) for point in prepared.transcription.points.values()]
    largest = max(graphs, key=lambda own: own.second.n_instructions())
    for graph in (largest.value, largest.first, largest.second):
        tape = _engine.Tape(graph)
        inputs = [np.full((POINTS, graph.nnz_in(i)), 0.3) for i in range(graph.n_in())]
        machine = 1e3 * _least(_once(graph, inputs), np.zeros(0))
        ours = 1e3 * _least(lambda _, tape=tape, inputs=inputs: tape(inputs), np.zeros(0)) / POINTS
        row(
            graph.name(),
            graph.n_instructions(),
            tape.statements,
            f"{machine:.1f} us",
            f"{ours:.1f} us a point",
        )


def _once(function: ca.Function, inputs: Sequence[np.ndarray]) -> Callable[[np.ndarray], object]:
    """One evaluation by CasADi's virtual machine, without the conversions of its Python interface."""
    buffer, call = function.buffer()
    kept = [np.ascontiguousarray(part[0]) for part in inputs]
    out = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, part in enumerate(kept):
        buffer.set_arg(i, memoryview(part))
    for i, part in enumerate(out):
        buffer.set_res(i, memoryview(part))
    return lambda _, kept=(kept, out, buffer): call()


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
                (limited, LIMIT, run_job, request, setting, job, Path(folder) / f"{k}.npz")
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
