"""``trajopt walk``: a biped walks with a velocity from footsteps, a pendulum and whole-body control."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from trajopt.cli.input import COUNT, default_option, json_option
from trajopt.cli.progress import busy
from trajopt.cli.report import say
from trajopt.cli.simulate import page_output, report_simulation
from trajopt.solution.output import check_apart, check_solution_output


@click.command("walk")
@click.argument("robot")
@default_option("--steps", 20, "N", "Number of steps.", kind=COUNT)
@default_option("--speed", 0.3, "M/S", "Forward; negative walks backwards.")
@default_option("--side-speed", 0.0, "M/S", "To the left; negative walks to the right.")
@default_option("--turn-rate", 0.0, "RAD/S", "To the left.")
@click.option(
    "--step-time", type=float, metavar="S", help="Single support.  [default: 1.9 sqrt(l / g), l the reach]"
)
@click.option(
    "--double-support",
    type=float,
    metavar="S",
    help="Double support between steps.  [default: 0.45 sqrt(l / g)]",
)
@click.option(
    "--clearance", type=float, metavar="M", help="Height of the swings.  [default: 0.06 of the reach]"
)
@click.option(
    "--crouch", type=float, metavar="M", help="Base lower than in the reference.  [default: searched]"
)
@default_option("--friction", 0.7, "MU", "Friction of the ground.")
@click.option("--plan", type=Path, metavar="PLAN", help="Save the plan: a solution, not yet simulated.")
@click.option("--output", "-o", type=Path, metavar="SIM", help="Save the simulated walk as a solution.")
@click.option("--html", type=Path, metavar="BOTH", help="Write a page that shows plan and simulation.")
@json_option
def walk_command(
    robot: str,
    clearance: float | None,
    crouch: float | None,
    friction: float,
    plan: Path | None,
    output: Path | None,
    html: Path | None,
    as_json: bool,
    **steps: Any,
) -> int:
    """Let ROBOT, a biped on soles, walk in MuJoCo without solving a problem.

    Footsteps, the centre of mass of a linear inverted pendulum over them, and whole-body control. Arms keep
    the reference posture. --plan saves what is tracked, for trajopt simulate with pushes or other friction.
    Exit status 0 when the walk is tracked, 1 when the robot falls or ends too far from it, 2 for bad input.
    """
    check_apart([plan, output, html], [Path(robot)])
    planned, motion = plan and check_solution_output(plan), output and check_solution_output(output)
    page = page_output(html)
    from trajopt.guesses.pendulum_walk import commanded_walk, walk_plan
    from trajopt.robot.catalogue import robot as load
    from trajopt.robot.legs import legs_only
    from trajopt.simulation.simulate import simulate

    legs = legs_only(load(robot))
    with busy(f"planning {steps['steps']} steps of {legs.name}"):
        walk = commanded_walk(legs, **steps)
        made = walk_plan(legs, walk, crouch=crouch, clearance=clearance, friction=friction)
    if planned is not None:
        made.save(planned)
    if not made.success:
        say(f"trajopt: warning: the walk of the pendulum is {made.statistics.status}", err=True)
    with busy(f"simulating {made.t[-1]:.3g} s in MuJoCo"):
        simulated = simulate(made, controller="whole-body")
    return report_simulation(made, simulated, motion, page, as_json)
