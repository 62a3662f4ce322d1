"""What rows that keep bodies apart cost: only where pairs come near, and for all pairs at all points."""

import time
from dataclasses import dataclass

import click
import numpy as np
from typing_extensions import override

import trajopt
from scripts.measure.shared import head, row
from trajopt.solving.exchange import Exchange, Look, along
from trajopt.solving.solving import solve

ROUNDS = 8
GRID = {"transcription": "legendre:3", "intervals": 20, "judge": False}


@dataclass
class AllPairs(Exchange):
    """Rows for every pair at every node and point, but for feet on the ground."""

    @property
    @override
    def band(self) -> float:
        return np.inf

    @override
    def add(self, look: Look) -> bool:
        before = sum(map(len, self.moments.values()))
        for column, pair in enumerate(self.bodies.pairs):
            rows = np.flatnonzero(look.regular & np.isfinite(look.distances[:, column]))
            self.moments[pair] |= {look.moments[row] for row in rows}
        return super().add(look) or sum(map(len, self.moments.values())) > before


@click.command()
@click.option("--distance", default=0.8, help="Of the jump, m.")
def clearance(distance: float) -> None:
    """Rows and solver time of solo12-jump until it is clear: only what comes near, and all pairs."""
    times = ("solver [s]", "build [s]", "look [s]")
    head("rows for", "solve", "rows", "of bodies", "iterations", *times, "least [mm]")
    problem = trajopt.load("solo12-jump", distance=distance)
    for name, kind in (("what comes near", Exchange), ("all pairs", AllPairs)):
        exchange, solution = kind(problem), solve(problem, **GRID)
        without = solution.statistics.constraints
        for number in range(ROUNDS):
            begun = time.perf_counter()
            look, statistics = exchange.look(solution), solution.statistics
            spent = time.perf_counter() - begun
            least = 1e3 * float((look.distances - exchange.bodies.margins).min())
            times = (f"{own:.2f}" for own in (statistics.wall_time_s, statistics.build_time_s, spent))
            rows = statistics.constraints
            row(name, number, rows, rows - without, statistics.iterations, *times, f"{least:.2f}")
            if not exchange.missing(look):
                break
            exchange.add(look)
            solution = solve(exchange.constrained(along(solution)), start=solution, **GRID)
