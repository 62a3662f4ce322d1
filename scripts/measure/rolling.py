"""Plans whose feet roll beside plans that hold the feet's centres, in MuJoCo (docs/simulation.md)."""

from dataclasses import dataclass
from typing import Any

import click

import trajopt
from scripts.measure.shared import head, median, row
from trajopt.problem.problem import Problem
from trajopt.simulation.report import SimulationReport
from trajopt.simulation.simulate import simulate
from trajopt.solution.solution import Solution
from trajopt.transcription.stage_functions import Derivatives
from trajopt.transcription.transcription import transcribe

# Problems with the cycles that are simulated, and robots.
PLANS = {
    ("quadruped-trot", 5): "solo12 go2 anymal_c",
    ("quadruped-walk", 5): "solo12 go2",
    ("quadruped-bound", 5): "solo12 go2 anymal_c",
    ("quadruped-jump-forward", 1): "solo12 go2 anymal_c",
    ("quadruped-box-up", 1): "go2",
    ("biped-gait", 1): "bolt",
}
# What neither plan nor controller knows of: nothing, friction, mass, errors of the start.
DISTURBANCES: tuple[dict[str, Any], ...] = (
    {},
    {"friction_scale": 0.8},
    {"mass_scale": 0.9},
    {"mass_scale": 1.1},
    *({"noise": 2e-3, "seed": seed} for seed in range(4)),
)


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """A plan in all simulations with feet that roll or do not."""

    reports: tuple[SimulationReport, ...]

    @classmethod
    def of(cls, plan: Solution, cycles: int, rolling: bool) -> "Tracked":
        """Simulate a plan under every disturbance."""
        runs = (simulate(plan, cycles=cycles, rolling=rolling, **settings) for settings in DISTURBANCES)
        return cls(reports=tuple(run.report for run in runs))

    @property
    def cells(self) -> tuple[str, str]:
        """Medians of the errors of base (at the end, mm) and joints (rms, mrad), and tracked runs."""
        end = median([1e3 * (report.base_error_end or 0.0) for report in self.reports])
        joints = median([1e3 * report.joint_error_rms for report in self.reports])
        passed = sum(report.passed for report in self.reports)
        return f"{end:.1f}, {joints:.1f}", f"{passed} of {len(self.reports)}"


@click.command("rolling")
@click.option("--only", default="", metavar="WORD", help="Plans or robots with this in their name.")
def rolling(only: str) -> None:
    """Errors of base (at the end, mm) and joints (rms, mrad): medians over disturbances; tracked runs."""
    arms = ("held, feet turn", "held, feet roll", "rolling, feet roll")
    costs = ("iterations", "thousand instructions")
    head("plan", "robot", *costs, *(title for arm in arms for title in (arm, "tracked")))
    for (problem, cycles), robots in PLANS.items():
        for name in (name for name in robots.split() if only in f"{problem} {name}"):
            robot = trajopt.robot(name)
            both = [trajopt.load(problem, robot=own) for own in (robot, robot.with_rolling_contacts())]
            held, rolls = (trajopt.solve(own) for own in both)
            runs = [Tracked.of(held, cycles, False), Tracked.of(held, cycles, True)]
            runs.append(Tracked.of(rolls, cycles, True))
            counts = [str(sum(e.iterations for e in plan.statistics.rounds)) for plan in (held, rolls)]
            sizes = [f"{_instructions(own) / 1e3:.0f}" for own in both]
            row(
                problem,
                name,
                " / ".join(counts),
                " / ".join(sizes),
                *(cell for run in runs for cell in run.cells),
            )


def _instructions(problem: Problem) -> int:
    """Of the largest function of second derivatives at a collocation point."""
    points = transcribe(problem).points.values()
    return max(Derivatives(point).second.n_instructions() for point in points)
