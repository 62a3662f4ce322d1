"""``trajopt simulate``, ``walk`` and ``push``: plans and walks in MuJoCo."""

from __future__ import annotations

import contextlib
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from typing_extensions import override

from trajopt.cli.input import (
    COUNT,
    NOT_REACHED,
    choice_option,
    default_option,
    hardware_options,
    is_given,
    json_option,
    load_plan,
    output_option,
    parse_settings,
    value_option,
)
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError, TrajoptError, failure, finite_number, line_in
from trajopt.motion.output import check_apart, check_output, check_solution_output, require_ending

if TYPE_CHECKING:
    from trajopt.control.mpc.replanning import ReplanningController
    from trajopt.motion.solution import Solution
    from trajopt.robot.link_wrench import LinkWrench
    from trajopt.simulation.settings import Controller
    from trajopt.simulation.simulate import Simulation

# Word of the controller that plans anew at each tick.
REPLANNING = "receding-horizon"


class ControllerName(click.Choice[str]):
    """The name of a controller, or a file that builds one."""

    @override
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        return value if str(value).endswith(".py") else super().convert(value, param, ctx)


@click.command("simulate")
@click.argument("file", type=Path)
@output_option("SIM", "Save the simulated motion as a solution.")
@click.option("--html", type=Path, metavar="BOTH", help="Write a page that shows plan and simulation.")
@default_option(
    "--controller",
    "joints",
    "NAME",
    f"Feedback of single joints, by the plan's gains, whole-body, or {REPLANNING}: plans made anew at each "
    "tick; or a FILE.py of your own with build(plan).",
    kind=ControllerName(["joints", "gains", "whole-body", REPLANNING]),
)
@choice_option("--qp-solver", ["piqp", "proxqp", "osqp"], "Of the programs of the whole body.")
@default_option("--cycles", 1, "N", "Cycles of a periodic plan.", kind=COUNT)
@default_option("--kp", 1.0, "X", "Factor on position gains.")
@default_option("--kd", 1.0, "X", "Factor on velocity gains.")
@hardware_options
@value_option(
    "--ground-offset", "FRAME=M", "Ground under a contact is higher by this, m. Repeatable.", multiple=True
)
@default_option("--push", 0.0, "N", "Force on the base to its left, halfway, N.")
@value_option(
    "--wrench",
    "FRAME:FX,FY,FZ[,TX,TY,TZ][:START,END]",
    "Force, N, and torque, N m, on a link in world axes, which the plan does not know. Repeatable.",
    multiple=True,
)
@click.option(
    "--rolling/--no-rolling", default=None, help="Feet with a radius roll, or do not.  [default: as planned]"
)
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
    for name, controller in (("kp", "joints"), ("kd", "joints"), ("qp-solver", "whole-body")):
        if is_given(name.replace("-", "_")) and settings["controller"] != controller:
            raise InputError(f"--{name} has no effect here", f"allowed: with --controller {controller}")
    offsets = parse_settings(settings.pop("ground_offset"), "--ground-offset")
    settings["ground_offsets"] = {
        frame: finite_number(f"--ground-offset for '{frame}'", text, "m") for frame, text in offsets.items()
    }
    settings["wrenches"] = [_wrench(text) for text in settings.pop("wrench")]
    motion, page = _checked_outputs(output, html)
    plan = load_plan(file)
    if settings["controller"] == REPLANNING:
        settings["controller"] = _replanning(plan, settings["cycles"])
    own = Path(settings["controller"]) if str(settings["controller"]).endswith(".py") else None
    with _code_of(own), busy(f"simulating {plan.t[-1]:.3g} s of {file} in MuJoCo"):
        if own is not None:
            settings["controller"] = _own_controller(own, plan)
        simulated = simulate(plan, **settings)
    return _report_simulation(plan, simulated, motion, page, as_json)


def _wrench(text: str) -> LinkWrench:
    """The wrench of one --wrench, zero outside its window. Raises `InputError`."""
    from trajopt.robot.link_wrench import LinkWrench

    frame, *parts = text.split(":")
    numbers = [
        [finite_number(f"a number of --wrench '{text}'", n) for n in part.split(",")] for part in parts
    ]
    window = numbers[1] if len(numbers) == 2 else [0.0, 1.0]
    if [len(part) for part in numbers] not in ([3], [6], [3, 2], [6, 2]) or not 0 <= window[0] < window[1]:
        allowed = "allowed: FRAME:FX,FY,FZ[,TX,TY,TZ][:START,END], N, N m, s, 0 <= START < END"
        raise InputError(f"--wrench is '{text}'", allowed)
    acting, scales = [*numbers[0], 0.0, 0.0, 0.0][:6], (0, 1, 1, 0) if len(numbers) == 2 else (1,)
    force, torque = ([[scale * n for n in part] for scale in scales] for part in (acting[:3], acting[3:]))
    return LinkWrench(frame=frame, force=force, torque=torque, times=sorted(2 * window)[: len(scales)])


def _own_controller(file: Path, plan: Solution) -> object:
    """What ``build(plan)`` of a file returns. Raises `InputError`."""
    from trajopt.robot.reading import existing_file

    build = runpy.run_path(str(existing_file(file, "controller"))).get("build")
    if not callable(build):
        raise InputError(f"controller file {file} has no build()", "def build(plan) -> TorqueController")
    return build(plan)


@contextlib.contextmanager
def _code_of(file: Path | None) -> Iterator[None]:
    """Turn errors that arise in a user's file into an `InputError` with the line."""
    try:
        yield
    except Exception as error:
        if file is None or isinstance(error, TrajoptError) or line_in(file.absolute(), error) is None:
            raise
        raise InputError(f"controller file {file}, {failure(error, file.absolute())}") from error


def _replanning(plan: Solution, cycles: int) -> ReplanningController:
    """What plans anew, for the robot of the plan's problem, or of its name. Raises `InputError`."""
    from trajopt.control.mpc.replanning import ReplanningController
    from trajopt.problem.catalogue import families, load
    from trajopt.robot.catalogue import robot
    from trajopt.robot.legs import legs_only

    about = plan.description
    given = {name: value for name, value in about.parameters.items() if value is not None}
    known = about.problem in families()
    chosen = load(about.problem, **given).robot if known else robot(about.robot)
    if chosen.nv > plan.model.nv:
        chosen = legs_only(chosen)
    with busy(f"preparing {chosen.name}"):
        return ReplanningController(chosen, plan, cycles=cycles)


@click.command("walk")
@click.argument("robot")
@default_option("--steps", 20, "N", "Number of steps.", kind=COUNT)
@default_option("--speed", 0.3, "M/S", "Forward; negative walks backwards.")
@default_option("--side-speed", 0.0, "M/S", "To the left; negative walks to the right.")
@default_option("--turn-rate", 0.0, "RAD/S", "To the left.")
@value_option("--step-time", "S", "Single support.  [default: 1.9 sqrt(l / g), l the reach]", float)
@value_option("--double-support", "S", "Double support between steps.  [default: 0.45 sqrt(l / g)]", float)
@value_option("--clearance", "M", "Height of the swings.  [default: 0.06 of the reach]", float)
@value_option("--crouch", "M", "Base lower than in the reference.  [default: searched]", float)
@default_option("--friction", 0.7, "MU", "Friction of the ground.")
@click.option("--plan", type=Path, metavar="PLAN", help="Save the plan: a solution, not yet simulated.")
@output_option("SIM", "Save the simulated walk as a solution.")
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
    planned, (motion, page) = plan and check_solution_output(plan), _checked_outputs(output, html)
    from trajopt.reduced.pendulum_walk import commanded_walk, walk_plan
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
    return _report_simulation(made, simulated, motion, page, as_json)


@click.command("push")
@click.argument("file", type=Path)
@output_option("OUT", "Plot to a .png, .svg or .pdf file.")
@click.option(
    "--controller",
    type=click.Choice(["joints", "gains", "whole-body"]),
    help="Measure one controller alone.  [default: all that the plan has]",
)
@value_option("--directions", "N", "Directions, evenly around the robot.  [default: 8; 2 in a plane]", COUNT)
@value_option(
    "--time",
    "S",
    "Time of the push.  [default: middle of a gait; where a plan ends at rest, its end]",
    float,
)
@value_option("--cycles", "N", "Cycles of a periodic plan.  [default: 6 sqrt(l / g) follow the push]", COUNT)
@default_option("--accuracy", 0.05, "X", "Relative accuracy of the impulses.")
@json_option
def push_command(
    file: Path, output: Path | None, controller: Controller | None, as_json: bool, **settings: Any
) -> int:
    """Measure the largest push that the plan in FILE survives in MuJoCo.

    A push is a level impulse on the base, over a tenth of sqrt(l / g), l the robot's reach; it is survived if
    the robot does not fall. Directions are degrees from the base's front, counter-clockwise.
    """
    from trajopt.simulation.push import largest_pushes
    from trajopt.view.plotting.writing import check_push_plot, write_push_plot

    check_apart([output], [file])
    if output is not None:
        check_push_plot(output)
    plan = load_plan(file)
    chosen = None if controller is None else (controller,)
    with busy(f"pushing {file} in MuJoCo"):
        report = largest_pushes(plan, controllers=chosen, **settings)
        if output is not None:
            write_push_plot(report, output)
    say(to_json(report.to_dict()) if as_json else report.table())
    return 0


def _checked_outputs(output: Path | None, html: Path | None) -> tuple[Path | None, Path | None]:
    """Files of the motion and of the page, if they are asked for; raises `InputError`."""
    motion, page = output and check_solution_output(output), html and check_output(html)
    if page is not None:
        require_ending(page, ".html")
    return motion, page


def _report_simulation(
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
