"""Draft, default grade and a fine accuracy of four motions: solver time, and errors of what is planned."""

from typing import Any

import click

import trajopt
from scripts.measure.shared import head, named, row
from trajopt.motion.solution import Solution
from trajopt.solving.graded import MOST_ROUNDS, solve_graded
from trajopt_library import problems

MOTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("ur5-reach", {}),
    ("quadruped-trot", {"robot": "go2"}),
    ("solo12-jump", {}),
    ("solo12-jump", {"height": 0.3}),
)
TITLES = ("", "", "solver s", "intervals", "local errors, reach", "open loop, rad", "verdict")
FINE = 1e-5  # m, open loop


@click.command()
def grades() -> None:
    """The first mesh, the refined one, and an open-loop error of 10 micrometres."""
    head(*TITLES)
    for name, values in MOTIONS:
        problem = problems.load(name, **values)
        motion = named(name, values)
        for word, rounds in (("draft", 1), ("default", MOST_ROUNDS)):
            found = solve_graded(problem, max_rounds=rounds)
            row(motion, word, f"{found.spent:.2f}", *_figures(found.solution))
        fine = solve_graded(problem, accuracy=FINE)
        row(motion, "fine", f"{fine.spent:.2f}", *_figures(fine.solution))


def _figures(plan: Solution) -> tuple[str, ...]:
    report = trajopt.check(plan)
    verdict = "holds" if report.ok else "misses"
    return str(plan.n_intervals), f"{report.local_position:.0e}", f"{report.open_loop_joints:.0e}", verdict
