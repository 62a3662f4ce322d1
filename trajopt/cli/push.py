"""``trajopt push``: the largest push that a plan survives, by direction and controller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from trajopt.cli.input import COUNT, default_option, json_option, load_plan
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.solution.output import check_apart

if TYPE_CHECKING:
    from trajopt.simulation.settings import Controller


@click.command("push")
@click.argument("file", type=Path)
@click.option("--output", "-o", type=Path, metavar="OUT", help="Plot to a .png, .svg or .pdf file.")
@click.option(
    "--controller",
    type=click.Choice(["joints", "whole-body"]),
    help="Measure one controller alone.  [default: both]",
)
@click.option(
    "--directions",
    type=COUNT,
    metavar="N",
    help="Directions, evenly around the robot.  [default: 8; 2 in a plane]",
)
@click.option(
    "--time",
    type=float,
    metavar="S",
    help="Time of the push.  [default: middle of a gait; where a plan ends at rest, its end]",
)
@click.option(
    "--cycles",
    type=COUNT,
    metavar="N",
    help="Cycles of a periodic plan.  [default: 6 sqrt(l / g) follow the push]",
)
@default_option("--accuracy", 0.05, "X", "Relative accuracy of the impulses.")
@json_option
def push_command(
    file: Path,
    output: Path | None,
    controller: Controller | None,
    directions: int | None,
    time: float | None,
    cycles: int | None,
    accuracy: float,
    as_json: bool,
) -> int:
    """Measure the largest push that the plan in FILE survives in MuJoCo.

    A push is a level impulse on the base, over a tenth of sqrt(l / g), l the robot's reach; it is survived if
    the robot does not fall. Directions are degrees from the base's front, counter-clockwise.
    """
    from trajopt.simulation.push import CONTROLLERS, largest_pushes
    from trajopt.view.plotting.pushes import check_push_plot, write_push_plot

    check_apart([output], [file])
    if output is not None:
        check_push_plot(output)
    plan = load_plan(file)
    chosen = CONTROLLERS if controller is None else (controller,)
    with busy(f"pushing {file} in MuJoCo"):
        report = largest_pushes(
            plan,
            controllers=chosen,
            directions=directions,
            time=time,
            cycles=cycles,
            accuracy=accuracy,
        )
        if output is not None:
            write_push_plot(report, output)
    say(to_json(report.to_dict()) if as_json else report.table())
    return 0
