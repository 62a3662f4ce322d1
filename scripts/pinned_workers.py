"""How much timed processes on cores of their own disturb each other: one solve alone, and on all at once.

uv run python -m scripts.pinned_workers
uv run python -m scripts.pinned_workers ur5-reach --repeats 20

Runs alternate between alone and together, so that drift of the machine hits both; medians are compared.
"""

from __future__ import annotations

import statistics
import tempfile
from dataclasses import dataclass
from pathlib import Path

import click

from trajopt.sweep.cores import physical_cores
from trajopt.sweep.engine import MODULES
from trajopt.sweep.plan import own_setting
from trajopt.sweep.records import SweepRequest
from trajopt.sweep.result import Job, TimedRun
from trajopt.sweep.run import run_job
from trajopt.workers import ProcessPerTaskExecutor
from trajopt.workers.task import announced

LIMIT = 600.0
FIGURES = ("wall_time", "function_time", "calibration")


@dataclass(frozen=True)
class Disturbance:
    """Medians alone and together, s: the solver's time, the functions', and the calibration beside it."""

    problem: str
    setting: str
    cores: int
    repeats: int
    alone: dict[str, float]
    together: dict[str, float]

    def lines(self) -> list[str]:
        """The figures in words."""
        head = f"{self.problem}, {self.setting}; {self.cores} cores, {self.repeats} repeats"
        return [head] + [
            f"{name:14} alone {1e3 * one:8.2f} ms, together {1e3 * self.together[name]:8.2f} ms: "
            f"{self.together[name] / one:.3f}"
            for name, one in self.alone.items()
        ]


def measure(problem: str, repeats: int) -> Disturbance:
    """The problem's own setting from its own guess, alone and on all cores in turn."""
    request = SweepRequest(problem=problem)
    setting = own_setting(request.load())
    job, cores = Job(setting=setting.name, start=0), physical_cores()
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPerTaskExecutor(len(cores), cores=cores, preload=MODULES) as executor,
    ):

        def together(count: int) -> list[TimedRun]:
            futures = [
                executor.submit(
                    announced, str(k), LIMIT, run_job, request, setting, job, Path(folder) / f"{k}.npz"
                )
                for k in range(count)
            ]
            return [future.result() for future in futures]

        together(len(cores))  # compiles where the cache is empty
        alone: list[TimedRun] = []
        crowded: list[TimedRun] = []
        for _ in range(repeats):
            alone += together(1)
            crowded += together(len(cores))
    return Disturbance(
        problem=problem,
        setting=setting.name,
        cores=len(cores),
        repeats=repeats,
        alone=_medians(alone),
        together=_medians(crowded),
    )


def _medians(runs: list[TimedRun]) -> dict[str, float]:
    return {name: statistics.median(getattr(run, name) for run in runs) for name in FIGURES}


@click.command()
@click.argument("problem", default="solo12-jump")
@click.option("--repeats", default=15, show_default=True, help="Runs alone, and together.")
def main(problem: str, repeats: int) -> None:
    """Print the medians alone and together."""
    for line in measure(problem, repeats).lines():
        click.echo(line)


if __name__ == "__main__":
    main()
