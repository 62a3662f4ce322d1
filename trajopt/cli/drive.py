"""``trajopt drive``: commands over time, and a robot that follows them in MuJoCo."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    NOT_REACHED,
    default_option,
    hardware_options,
    is_given,
    json_option,
    output_option,
    value_option,
)
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError, require_positive
from trajopt.solution.output import check_apart, check_solution_output

if TYPE_CHECKING:
    from trajopt.robot.robot import Robot
    from trajopt.simulation.settings import Impulse
    from trajopt.terrain.piecewise import PiecewiseTerrain


@click.command("drive")
@click.argument("robot")
@value_option("--script", "CSV", "Commands over time; columns time, gait, speed, lateral, turn_rate, height.", Path)
@output_option("RUN", "Save the motion as a solution.")
@value_option("--seconds", "S", "Duration.  [default: 2 s after the last command]", float)
@default_option("--period", 0.01, "S", "Of plans.")
@default_option("--plan-delay", 0.01, "S", "After which a plan is ready, however long it took.")
@hardware_options
@value_option(
    "--push", "TIME,DEGREES,SIZE", "Level impulse on the base: s, from its front, N s. Repeatable.", multiple=True
)
@value_option("--slope", "DEG", "Slope in front of the robot, of which it does not know.", float)
@value_option("--boxes", "PART", "Boxes in front of it, up to this part of its length high.", float)
@click.option("--rolling/--no-rolling", default=True, help="Feet with a radius roll.  [default: they do]")
@json_option
def drive_command(
    robot: str,
    script: Path | None,
    output: Path | None,
    seconds: float | None,
    period: float,
    plan_delay: float,
    push: tuple[str, ...],
    slope: float | None,
    boxes: float | None,
    as_json: bool,
    **hardware: Any,
) -> int:
    """Drive ROBOT, which has legs and a free base, by the commands of a script, in MuJoCo.

    Whole-body motions are planned anew every --period while it moves. Simulated time waits for the solver, and a
    plan is used after --plan-delay: the motion does not depend on the machine. Exit status 0, 1 when the robot
    falls, 2 for bad input.
    """
    if script is None:
        raise InputError("no --script: commands from a browser are not there yet", "allowed: --script CSV")
    check_apart([output], [script, Path(robot)])
    target = output and check_solution_output(output)
    if seconds is not None:
        require_positive("--seconds", seconds, "s")
    if slope is not None and boxes is not None:
        raise InputError("--slope and --boxes are both given", "allowed: one of them")
    if is_given("seed") and boxes is None and not hardware["noise"] and not hardware["sensor_noise"]:
        raise InputError("--seed has no effect here", "allowed: with --noise, --sensor-noise or --boxes")
    from trajopt.mpc.commands import read_commands
    from trajopt.mpc.controller import ControllerSettings
    from trajopt.mpc.drive import drive
    from trajopt.robot.catalogue import robot as load
    from trajopt.schedule.gaits import gait_names

    loaded = load(robot)
    commands = read_commands(script, gait_names(loaded))
    settings = ControllerSettings(period=period, delay=plan_delay)
    pushes = [_push(loaded, text) for text in push]
    ground = _ground(loaded, slope, boxes, hardware["seed"])
    with busy(f"driving {loaded.name} in MuJoCo by {script}"):
        driven = drive(
            loaded, commands, duration=seconds, settings=settings, pushes=pushes, ground=ground, **hardware
        )
    if target is not None:
        driven.as_solution().save(target)
    report = driven.report
    say(to_json(report.to_dict()) if as_json else report.table())
    return 0 if report.passed else NOT_REACHED


def _push(robot: Robot, text: str) -> Impulse:
    """The impulse of one --push, as long as those of ``trajopt push``. Raises `InputError`."""
    from trajopt.robot.natural_units import NaturalUnits
    from trajopt.simulation.push import DURATION
    from trajopt.simulation.settings import Impulse

    try:
        time, degrees, size = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--push is '{text}'", "allowed: TIME,DEGREES,SIZE, numbers") from None
    lasts = DURATION * NaturalUnits.of(robot.model).time
    return Impulse(time=time, direction=math.radians(degrees), size=size, duration=lasts)


def _ground(robot: Robot, slope: float | None, boxes: float | None, seed: int) -> PiecewiseTerrain | None:
    from trajopt.mpc.hidden_ground import boxes_ahead, slope_ahead

    if slope is not None:
        return slope_ahead(slope)
    return None if boxes is None else boxes_ahead(robot, boxes, seed)
