"""Quadrupeds in MuJoCo under disturbances that plan and controller do not know of (docs/control.md)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

import click

import trajopt
from scripts.measure.shared import head, row
from trajopt.motion.solution import Solution
from trajopt.simulation.report import SimulationReport
from trajopt.simulation.settings import Controller
from trajopt.simulation.simulate import simulate

ROBOTS = ("solo12", "go2", "anymal_c")
# Plans and their cycles.
PLANS = (("walk", 5), ("trot", 5), ("stand-up", 1), ("jump-forward", 1))
CONTROLLERS = get_args(Controller)
OFFSET = 0.02
# Settings by name; the frame of the front left foot is that of each plan.
DISTURBANCES: dict[str, dict[str, Any]] = {
    "none": {},
    "friction 0.7": {"friction_scale": 0.7},
    "mass 1.2": {"mass_scale": 1.2},
    "mass 0.8": {"mass_scale": 0.8},
    "CoM 2 cm forward": {"com_offset": (OFFSET, 0.0, 0.0)},
    "CoM 2 cm back": {"com_offset": (-OFFSET, 0.0, 0.0)},
    "CoM 2 cm left": {"com_offset": (0.0, OFFSET, 0.0)},
    "ground +2 cm": {"front_left": OFFSET},
    "ground -2 cm": {"front_left": -OFFSET},
    "sensor noise 1e-3": {"sensor_noise": 1e-3},
    "delay 1 ms": {"delay": 1},
    "delay 2 ms": {"delay": 2},
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A plan, by name, under a disturbance with a controller."""

    plan: str
    controller: Controller
    report: SimulationReport


@click.command("robustness")
@click.option("--only", default="", metavar="WORD", help="Plans or robots with this in their name.")
@click.option("--controller", "controllers", multiple=True, type=click.Choice(CONTROLLERS))
def robustness(only: str, controllers: tuple[Controller, ...]) -> None:
    """Count the plans that are tracked under each disturbance, and name those that are not."""
    wanted = controllers or CONTROLLERS
    plans = [plan for plan in _plans() if only in plan[0]]
    head("disturbance", *(f"{title} {own}" for own in wanted for title in ("tracked,", "worst end, mm,")))
    found = {}
    for name, settings in DISTURBANCES.items():
        found[name] = [trial for plan in plans for trial in _trials(*plan, settings, wanted)]
        row(name, *(cell for own in wanted for cell in _cells(found[name], own)))
    for own in wanted:
        click.echo(f"\nNot tracked, {own}:\n")
        for name, trials in found.items():
            failed = [t for t in trials if t.controller == own and not t.report.passed]
            if failed:
                click.echo(f"- {name}: " + "; ".join(f"{t.plan} {_how(t.report)}" for t in failed))


def _plans() -> Iterator[tuple[str, Solution, int]]:
    for robot in ROBOTS:
        for name, cycles in PLANS:
            yield f"{name} {robot}", trajopt.solve(trajopt.load(f"quadruped-{name}", robot=robot)), cycles


def _trials(
    name: str, plan: Solution, cycles: int, settings: dict[str, Any], controllers: tuple[Controller, ...]
) -> Iterator[Trial]:
    own = {key: value for key, value in settings.items() if key != "front_left"}
    if "front_left" in settings:
        own["ground_offsets"] = {plan.contact_frames[0]: settings["front_left"]}
    for controller in controllers:
        report = simulate(plan, cycles=cycles, controller=controller, **own).report
        yield Trial(plan=name, controller=controller, report=report)


def _cells(trials: list[Trial], controller: Controller) -> tuple[str, str]:
    """How many are tracked, and the worst error of the base at the end of those that stand, mm."""
    own = [trial.report for trial in trials if trial.controller == controller]
    errors = [1e3 * (report.base_error_end or 0.0) for report in own if not report.fell]
    return f"{sum(report.passed for report in own)} of {len(own)}", f"{max(errors, default=0.0):.0f}"


def _how(report: SimulationReport) -> str:
    if report.fell:
        return f"fell at {report.fall_time:.2f} s"
    ends = max(report.base_error_end or 0.0, report.base_error_held or 0.0)
    turn = "" if ends > report.reach / 20 else f" and {report.base_turn_end:.2f} rad"
    return f"{1e3 * ends:.0f} mm{turn}"
