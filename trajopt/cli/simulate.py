"""``trajopt simulate``: run a plan in MuJoCo with its torques and joint feedback."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    controller_option,
    default_option,
    is_given,
    json_option,
    load_plan,
    parse_settings,
)
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError
from trajopt.solution.output import check_apart, check_output, check_solution_output, require_ending

if TYPE_CHECKING:
    from trajopt.simulation.simulate import Simulation
    from trajopt.solution.solution import Solution


@click.command("simulate")
@click.argument("file", type=Path)
@click.option("--output", "-o", type=Path, metavar="SIM", help="Save the simulated motion as a solution.")
@click.option("--html", type=Path, metavar="BOTH", help="Write a page that shows plan and simulation.")
@controller_option
@click.option(
    "--qp-solver",
    type=click.Choice(["piqp", "proxqp", "osqp"]),
    default="piqp",
    show_default=True,
    help="Of the programs of the whole body.",
)
@default_option("--cycles", 1, "N", "Cycles of a periodic plan.", kind=COUNT)
@default_option("--kp", 1.0, "X", "Factor on position gains.")
@default_option("--kd", 1.0, "X", "Factor on velocity gains.")
@click.option("--timestep", type=float, metavar="S", help="Longest step of the physics.  [default: derived]")
@default_option("--control-rate", 1000.0, "HZ", "Rate of the controller.")
@default_option("--friction-scale", 1.0, "X", "Factor on friction.")
@default_option("--mass-scale", 1.0, "X", "Factor on masses and inertias.")
@default_option("--noise", 0.0, "SIGMA", "Noise on the initial state, natural units.")
@default_option("--sensor-noise", 0.0, "SIGMA", "Noise on the state measured at each tick, natural units.")
@default_option("--seed", 0, "K", "Seed of --noise and --sensor-noise.", kind=COUNT)
@default_option("--delay", 0, "TICKS", "Whole ticks by which measurements are late.", kind=COUNT)
@default_option("--torque-step", 0.0, "NM", "Torques are rounded to multiples of this; 0: they are not.")
@default_option("--torque-rate", 0.0, "NM/S", "Fastest change of a torque; 0: no limit.")
@default_option(
    "--com-offset",
    (0.0, 0.0, 0.0),
    "X Y Z",
    "Offset of the robot's centre of mass, base frame, m.",
    kind=click.Tuple([float, float, float]),
)
@click.option(
    "--ground-offset",
    "ground_offsets",
    multiple=True,
    metavar="FRAME=M",
    help="Ground under a contact is higher by this, m. Repeatable.",
)
@default_option("--push", 0.0, "N", "Force on the base to its left, halfway, N.")
@click.option("--rolling", is_flag=True, help="Feet with a radius roll, which plans neglect.")
@json_option
def simulate_command(
    file: Path, output: Path | None, html: Path | None, as_json: bool, **settings: Any
) -> int:
    """Run the plan in FILE in MuJoCo: how well is it tracked?

    The model is made from the file alone. Exit status 0 when the plan is tracked, 1 when the robot falls or
    ends too far from it, 2 for bad input.
    """
    from trajopt.simulation.simulate import simulate

    check_apart([output, html], [file])
    if is_given("seed") and not settings["noise"] and not settings["sensor_noise"]:
        raise InputError("--seed has no effect here", "allowed: with --noise or --sensor-noise SIGMA")
    for name, own in (("kp", "joints"), ("kd", "joints"), ("qp_solver", "whole-body")):
        if is_given(name) and settings["controller"] != own:
            option = name.replace("_", "-")
            raise InputError(f"--{option} has no effect here", f"allowed: with --controller {own}")
    offsets = parse_settings(settings["ground_offsets"], "--ground-offset")
    settings["ground_offsets"] = {frame: _metres(frame, text) for frame, text in offsets.items()}
    motion, page = output and check_solution_output(output), page_output(html)
    plan = load_plan(file)
    with busy(f"simulating {plan.t[-1]:.3g} s of {file} in MuJoCo"):
        simulated = simulate(plan, **settings)
    return report_simulation(plan, simulated, motion, page, as_json)


def page_output(html: Path | None) -> Path | None:
    """The page, if one is named and can be written; raises `InputError`."""
    page = html and check_output(html)
    if page is not None:
        require_ending(page, ".html")
    return page


def report_simulation(
    plan: Solution, simulated: Simulation, motion: Path | None, page: Path | None, as_json: bool
) -> int:
    """Write what a simulation is asked for, print its report; the exit status."""
    if motion is not None:
        simulated.as_solution().save(motion)
    if page is not None:
        from trajopt.view.replay.show import replay

        replay([plan, simulated.as_solution()], html=page, labels=["plan", "simulation"])
    report = simulated.report
    say(to_json(report.to_dict()) if as_json else report.table())
    return 0 if report.passed else NOT_REACHED


def _metres(frame: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--ground-offset for '{frame}' is '{text}'", "allowed: a number, m") from None
