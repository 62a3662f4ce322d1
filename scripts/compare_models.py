"""Every pair of models that docs/modelling compares: size, iterations, time and optimum, as one table.

uv run python -m scripts.compare_models [--only hopper] [--solver ipopt]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import click

from trajopt.certify.check import check
from trajopt.problem.problem import Problem
from trajopt.reduced.base_conversion import with_virtual_base
from trajopt.schedule.schedule import Schedule
from trajopt.solution.solution import Solution
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.solving import solve
from trajopt.terms import TimeCost
from trajopt_library import problems

HEADER = (
    "| compared | model | variables | rows | iterations | solver s | objective | check |",
    "|---|---|---|---|---|---|---|---|",
)


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One row: what is compared, which model, and the problem; ``build`` is called when its turn comes."""

    what: str
    model: str
    build: Callable[[], Problem]
    intervals: int | None = None


def family(what: str, name: str, **variants: dict[str, object]) -> Iterator[Compared]:
    """One row for each variant: parameters of the family of that name."""
    for model, parameters in variants.items():
        yield Compared(
            what=what,
            model=model.replace("_", " "),
            build=lambda parameters=parameters: problems.load(name, **parameters),
        )


def free_durations(name: str, share: float) -> Problem:
    """The problem with every duration free between ``share`` and 1/share of its own, and time priced."""
    problem = problems.load(name)
    phases = tuple(
        replace(phase, duration_bounds=(share * phase.duration, phase.duration / share))
        for phase in problem.schedule.phases
    )
    return replace(problem, schedule=Schedule(phases), terms=(*problem.terms, TimeCost(weight=0.02)))


def rows() -> Iterator[Compared]:
    """All comparisons, in the order of the issue's items."""
    yield from family(
        "actuators (UR5 reach)",
        "ur5-reach",
        torque_source={},
        acceleration_source={"actuation": "acceleration"},
        velocity_source={"actuation": "velocity"},
    )
    yield from family(
        "torque-speed envelope (Solo12 jump)",
        "solo12-jump",
        no_motors={},
        motors_at_24_V={"voltage": 24},
        motors_at_6_V={"voltage": 6},
    )
    jump = {"distance": 0.2, "yaw": 0.6}
    yield from family("base (Solo12 jump, yaw 0.6)", "solo12-jump", quaternion=jump)
    for order in ("ZYX", "YXZ"):
        yield Compared(
            what="base (Solo12 jump, yaw 0.6)",
            model=f"virtual joints {order}",
            build=lambda order=order: with_virtual_base(problems.load("solo12-jump", **jump), order),
        )
    yield from family("base (Solo12 half flip)", "solo12-flip", quaternion={})
    yield Compared(
        what="base (Solo12 half flip)",
        model="virtual joints ZYX",
        build=lambda: with_virtual_base(problems.load("solo12-flip"), "ZYX"),
    )
    yield from family(
        "coordinates (planar hopper)",
        "hopper-hop",
        excess={},
        minimal={"coordinates": "minimal"},
        excess_impact={"touchdown": "impact"},
        minimal_impact={"touchdown": "impact", "coordinates": "minimal"},
    )
    yield from family(
        "touchdown (Solo12 jump)", "solo12-jump", zero_velocity={}, impact={"touchdown": "impact"}
    )
    yield from family("durations (Solo12 jump)", "solo12-jump", given={})
    yield Compared(
        what="durations (Solo12 jump)",
        model="free",
        build=lambda: free_durations("solo12-jump", 0.5),
    )
    yield from family(
        "goal (IRB 1600 transfer)",
        "irb1600-transfer",
        minimum_effort={},
        minimum_time={"minimise": "time"},
    )


@click.command()
@click.option("--only", default="", help="rows whose first column has this text")
@click.option("--solver", type=click.Choice(list(SOLVERS)), default="ipopt")
def main(only: str, solver: str) -> None:
    """Solve both sides of every pair from their own guesses and print the table."""
    click.echo("\n".join(HEADER))
    for row in rows():
        if only.lower() in row.what.lower():
            click.echo(line(row, solve(row.build(), solver=solver, intervals=row.intervals)))


def line(row: Compared, found: Solution) -> str:
    """One row of the table."""
    meta = found.meta
    objective = f"{meta['objective']:.5g}" if found.success else meta["status"].replace("_", " ")
    verdict = ", ".join(check(found).failures()) or "ok"
    return (
        f"| {row.what} | {row.model} | {meta['variables']} | {meta['constraints']} | {meta['iterations']} "
        f"| {meta['wall_time_s']:.2f} | {objective} | {verdict} |"
    )


if __name__ == "__main__":
    main()
