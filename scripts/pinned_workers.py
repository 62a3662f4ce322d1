"""How much timed processes on cores of their own disturb each other: one solve alone, and on all at once.

uv run python -m scripts.pinned_workers
uv run python -m scripts.pinned_workers ur5-reach --repeats 20

Runs alternate between alone and together, so that drift of the machine hits both; medians are compared.
"""

from __future__ import annotations

import statistics
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click

from trajopt.problem.catalogue import families
from trajopt.problem.family import choose
from trajopt.study.sweep.cores import physical_cores
from trajopt.study.sweep.plan import own_setting
from trajopt.study.sweep.process import Pool
from trajopt.study.sweep.result import Job, Run

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
    setting = own_setting(choose(families(), problem).load({}))
    cores = physical_cores()
    with tempfile.TemporaryDirectory() as folder, Pool(cores) as pool:

        def task(number: int) -> dict[str, Any]:
            return {
                "task": "run", "problem": problem, "values": {}, "setting": setting.to_dict(),
                "job": asdict(Job(setting=setting.name, start=0)), "limit": LIMIT,
                "file": str(Path(folder) / f"{number}.npz"),
                "limits": {"sigma": 0.1, "max_iterations": 500, "max_time": 60.0},
            }  # fmt: skip

        def together(count: int) -> list[Run]:
            for number in range(count):
                pool.start(None, task(number))
            return [Run.from_dict(pool.take()[1]["run"]) for _ in range(count)]

        together(len(cores))  # compiles where the cache is empty
        alone: list[Run] = []
        crowded: list[Run] = []
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


def _medians(runs: list[Run]) -> dict[str, float]:
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
