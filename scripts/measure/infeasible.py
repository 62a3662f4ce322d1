"""Settings that cannot be done: how soon that is known, beside the same problem at a feasible parameter."""

from typing import Any

import click

from scripts.measure.shared import head, named, row
from trajopt.solving.graded import Graded, solve_graded
from trajopt_library import problems

# Problem, its other parameters, the one that decides: its infeasible and its feasible value.
SETTINGS: tuple[tuple[str, dict[str, Any], str, float, float], ...] = (
    ("biped-jump-up", {"robot": "talos"}, "height", 0.2, 0.04),
    ("solo12-jump", {}, "torque_limit", 0.4, 1.0),
    ("quadruped-jump-forward", {"robot": "go2"}, "distance", 2.5, 0.6),
    ("hopper-hop", {}, "friction", 0.05, 0.7),
    ("hopper-hop", {}, "stance", 0.02, 0.4),
    ("quadruped-trot", {"robot": "go2"}, "speed", 5.0, 1.2),
    ("ur5-reach", {}, "duration", 0.1, 0.27),
    ("arm-reach", {"robot": "panda"}, "duration", 0.2, 0.28),
    ("arm-pick-place", {"robot": "panda"}, "payload", 60.0, 20.0),
    ("arm-pick-place", {"robot": "panda"}, "duration", 0.8, 2.0),
)


@click.command()
@click.option("--max-time", default=60.0, help="Of one mesh, s.")
def infeasible(max_time: float) -> None:
    """Verdict, iterations and solver time of ten infeasible settings, and of feasible partners, in turn."""
    head("problem", "infeasible", "verdict", "iterations", "s", "feasible", "verdict", "s", "ratio")
    for name, fixed, parameter, bad, good in SETTINGS:
        found, partner = (
            solve_graded(problems.load(name, **fixed, **{parameter: value}), max_time=max_time)
            for value in (bad, good)
        )
        iterations = sum(one.iterations for one in found.rounds)
        failed = f"{parameter}={bad:g}", _verdict(found), iterations, f"{found.spent:.2f}"
        solved = f"{parameter}={good:g}", _verdict(partner), f"{partner.spent:.2f}"
        row(named(name, fixed), *failed, *solved, f"{found.spent / partner.spent:.1f}")


def _verdict(found: Graded) -> str:
    statistics = found.solution.statistics
    certified = ", certified" if statistics.certified_infeasible else ""
    return f"{statistics.status.replace('_', ' ')}{certified}"
