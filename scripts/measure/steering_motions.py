"""Finite motions whose rest is replanned at each tick, beside the tracker (docs/mpc.md)."""

import math

import click
import numpy as np

import trajopt
from scripts.measure.shared import head, row
from scripts.measure.steering import impulse
from trajopt.control.mpc import ReplanningController

# Finite motions: families and robots.
MOTIONS = (
    ("solo12-jump", "solo12"),
    ("quadruped-box-up", "go2"),
    ("quadruped-jump-forward", "anymal_c"),
    ("quadruped-stairs", "go2"),
    ("quadruped-stairs", "anymal_c"),
    ("quadruped-steps", "solo12"),
    ("quadruped-backflip", "go2"),
    ("biped-walk", "g1"),
    ("biped-jump-up", "g1"),
    ("biped-step-up", "talos"),
)


@click.command("replanned")
@click.option("--push", default=0.2, show_default=True, help="Impulse, natural units.")
def replanned(push: float) -> None:
    """Finite motions by the tracker, and replanned: final error of the base, mm."""
    cases = ("as planned", "mass 1.2", "friction 0.7", "pushed forward", "pushed left")
    head("motion", "robot", *(f"{case}: tracked, replanned" for case in cases), "plan, ms", "99 %, ms")
    for name, word in MOTIONS:
        problem = trajopt.load(name) if name.startswith(word) else trajopt.load(name, robot=word)
        plan, times = trajopt.solve(problem), []
        middle, ends = 0.3 * float(plan.t[-1]), []
        for given in (
            {},
            {"mass_scale": 1.2},
            {"friction_scale": 0.7},
            *({"impulse": impulse(problem.robot, side, push, middle)} for side in (0.0, 0.5 * math.pi)),
        ):
            anew = ReplanningController(problem.robot, plan)
            reports = [trajopt.simulate(plan, controller=how, **given).report for how in ("whole-body", anew)]
            times += anew.report.planning[1:]
            ends.append(", ".join("fell" if r.fell else f"{1e3 * r.base_error_end:.0f}" for r in reports))
        row(name, problem.robot.name, *ends, *(f"{1e3 * np.percentile(times, p):.1f}" for p in (50, 99)))
