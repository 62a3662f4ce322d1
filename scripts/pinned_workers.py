"""How much timed processes on cores of their own disturb each other: one solve alone, and on all at once.

uv run python -m scripts.pinned_workers
uv run python -m scripts.pinned_workers ur5-reach --repeats 20

Runs alternate between alone and together, so that drift of the machine hits both; medians are compared.
"""

from __future__ import annotations

import statistics
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from trajopt.catalogue import families
from trajopt.family import choose
from trajopt.sweep.cores import physical_cores
from trajopt.sweep.plan import own_setting
from trajopt.sweep.process import Pool
from trajopt.sweep.result import Job, Run

LIMIT = 600.0


@click.command()
@click.argument("problem", default="solo12-jump")
@click.option("--repeats", default=15, show_default=True, help="Runs alone, and together.")
def main(problem: str, repeats: int) -> None:
    """Print the medians alone and together, of the solver's time and of the calibration beside it."""
    setting = own_setting(choose(families(), problem).load({}))
    cores = physical_cores()
    job = Job(setting=setting.name, start=0)
    with tempfile.TemporaryDirectory() as folder, Pool(cores) as pool:

        def task(number: int) -> dict[str, Any]:
            return {
                "task": "run", "problem": problem, "values": {}, "setting": setting.to_dict(),
                "job": asdict(job), "file": str(Path(folder) / f"{number}.npz"), "limit": LIMIT,
                "limits": {"sigma": 0.1, "max_iterations": 500, "max_time": 60.0},
            }  # fmt: skip

        def together(count: int) -> list[Run]:
            for number in range(count):
                pool.start(None, task(number))
            return [Run.from_dict(pool.take()[1]["run"]) for _ in range(count)]

        together(len(cores))  # compiles where the cache is empty
        alone, crowded = [], []
        for _ in range(repeats):
            alone += together(1)
            crowded += together(len(cores))
    click.echo(f"{problem}, {setting.name}; {len(cores)} cores, {repeats} repeats")
    for name in ("wall_time", "function_time", "calibration"):
        one, many = (statistics.median(getattr(run, name) for run in runs) for runs in (alone, crowded))
        click.echo(f"{name:14} alone {1e3 * one:8.2f} ms, together {1e3 * many:8.2f} ms: {many / one:.3f}")


if __name__ == "__main__":
    main()
