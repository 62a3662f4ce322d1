"""``trajopt drive``: commands over time, and a robot that follows them in MuJoCo."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    NOT_REACHED,
    choice_option,
    default_option,
    hardware_options,
    is_given,
    json_option,
    output_option,
    value_option,
)
from trajopt.cli.interruption import INTERRUPTION
from trajopt.cli.progress import busy
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError, require_positive
from trajopt.motion.output import check_apart, check_solution_output

if TYPE_CHECKING:
    from trajopt.collision import Obstacle
    from trajopt.robot.robot import Robot
    from trajopt.simulation.settings import Impulse
    from trajopt.simulation.simulated import SimulatedMotion
    from trajopt.terrain.piecewise import PiecewiseTerrain

# Options of drives by a script.
SCRIPTED = {
    "period": "--period",
    "plan_delay": "--plan-delay",
    "push": "--push",
    "slope": "--slope",
    "boxes": "--boxes",
    "as_json": "--json",
}
# Those of robots on legs.
ON_LEGS = ("push", "slope", "boxes", "terrain", "start", "rolling")
# Those of live drives.
LIVE = {
    "port": "--port",
    "no_open": "--no-open",
    "to_target": "--target",
    "exit_with_page": "--exit-with-page",
}


@click.command("drive")
@click.argument("robot")
@value_option(
    "--script",
    "CSV",
    "Commands over time; columns time, gait, speed, lateral, turn_rate, height; of an arm time, x, y, z.",
    Path,
)
@output_option("RUN", "Save the motion as a solution.")
@value_option("--seconds", "S", "Duration.  [default: 2 s after the last command; live, until Ctrl-C]", float)
@value_option("--port", "N", "Of the page of a live drive.  [default: the first free one from 7000 on]", int)
@click.option("--no-open", is_flag=True, help="Do not open a browser.")
@click.option("--target", "to_target", is_flag=True, help="Drive the tool of an arm to a target.")
@click.option("--exit-with-page", is_flag=True, help="End a live drive when its page is closed.")
@default_option("--period", 0.01, "S", "Of plans.")
@default_option("--plan-delay", 0.01, "S", "After which a plan is ready, however long it took.")
@hardware_options
@value_option(
    "--push",
    "TIME,DEGREES,SIZE",
    "Level impulse on the base: s, from its front, N s. Repeatable.",
    multiple=True,
)
@value_option("--slope", "DEG", "Slope in front of the robot, of which it does not know.", float)
@value_option("--boxes", "PART", "Boxes in front of it, up to this part of its length high.", float)
@value_option("--terrain", "KIND:NAME=VALUE,...", "Known ground: steps, stairs, box, slope, or FILE.json.")
@choice_option("--start", ("standing", "lying"), "A quadruped on point feet that lies stands up first.")
@value_option(
    "--post",
    "X,Y,HEIGHT,RADIUS",
    "Post that an arm keeps clear of, m. Repeatable.",
    multiple=True,
)
@value_option(
    "--payload",
    "MASS[,FRAME[,X,Y,Z]]",
    "Mass in kg that ROBOT carries, at a place of a frame, m.  [default: at the base, or the tool of an arm]",
)
@click.option("--rolling/--no-rolling", default=True, help="Feet with a radius roll.  [default: they do]")
@json_option
def drive_command(
    robot: str,
    script: Path | None,
    output: Path | None,
    seconds: float | None,
    port: int | None,
    no_open: bool,
    to_target: bool,
    exit_with_page: bool,
    period: float,
    plan_delay: float,
    push: tuple[str, ...],
    slope: float | None,
    boxes: float | None,
    terrain: str | None,
    start: str,
    post: tuple[str, ...],
    payload: str | None,
    as_json: bool,
    **hardware: Any,
) -> int:
    """Drive ROBOT in MuJoCo: from a page in the browser, or by the commands of a script.

    Whole-body motions are replanned every --period while it moves. By a script, simulated time waits for
    the solver, and a plan is used after --plan-delay, so that the motion does not depend on times; ROBOT has
    legs and a free base, or is an arm whose tool goes to places. Without one, a page in the browser steers it
    in real time, or with --target the tool of an arm, until Ctrl-C. Exit status 0, 1 when the robot falls by
    a script, 2 for bad input.
    """
    for name, option in (SCRIPTED if script is None else LIVE).items():
        if is_given(name):
            how, other = ("without", "with") if script is None else ("with", "without")
            raise InputError(f"{option} {how} --script", f"allowed: {other} --script")
    if is_given("seed") and boxes is None and not hardware["noise"] and not hardware["sensor_noise"]:
        raise InputError("--seed has no effect here", "allowed: with --noise, --sensor-noise or --boxes")
    if script is None:
        page: dict[str, Any] = {"seconds": seconds, "exit_with_page": exit_with_page, "payload": payload}
        given = {name: value for name, value in hardware.items() if is_given(name)}
        given["lying"] = start == "lying"
        if to_target:
            given["obstacles"] = _posts(post)
            if terrain is not None:
                raise InputError("--terrain with --target", "allowed: with a robot on legs")
        elif post:
            raise InputError("--post without --target", "allowed: with an arm")
        else:
            given["terrain"] = terrain and _known(terrain)
        return _live(robot, output, page, port=port, open_browser=not no_open, target=to_target, **given)
    check_apart([output], [script, Path(robot)])
    target = output and check_solution_output(output)
    if seconds is not None:
        require_positive("--seconds", seconds, "s")
    grounds = [name for name in ("slope", "boxes", "terrain") if is_given(name)]
    if len(grounds) > 1:
        raise InputError(f"--{grounds[0]} and --{grounds[1]} are both given", "allowed: one of them")
    from trajopt.control.mpc.arm import ArmSettings
    from trajopt.control.mpc.commands import read_commands
    from trajopt.control.mpc.receding import ControllerSettings
    from trajopt.schedule.gaits import gait_names
    from trajopt.simulation.arm_drive import drive_arm, read_targets
    from trajopt.simulation.lockstep import drive

    loaded = _robot(robot, payload)
    driving = busy(f"driving {loaded.name} in MuJoCo by {script}")
    driven: SimulatedMotion
    if loaded.base == "fixed":
        for name in ON_LEGS:
            if is_given(name):
                raise InputError(f"--{name} with '{loaded.name}', an arm", "allowed: with a robot on legs")
        targets = read_targets(script)
        hardware["obstacles"] = _posts(post)
        hardware["settings"] = ArmSettings(period=period, delay=plan_delay)
        with driving:
            driven = drive_arm(loaded, targets, duration=seconds, **hardware)
    elif post:
        raise InputError(f"--post with '{loaded.name}', on legs", "allowed: with an arm")
    else:
        commands = read_commands(script, gait_names(loaded))
        pushes = [_push(loaded, text) for text in push]
        ground = _ground(loaded, slope, boxes, hardware["seed"])
        hardware["settings"] = ControllerSettings(period=period, delay=plan_delay)
        hardware.update(terrain=terrain and _known(terrain), lying=start == "lying")
        with driving:
            driven = drive(loaded, commands, duration=seconds, pushes=pushes, ground=ground, **hardware)
    if target is not None:
        driven.as_solution().save(target)
    report = driven.report
    say(to_json(report.to_dict()) if as_json else report.table())
    return 0 if report.passed else NOT_REACHED


def _live(robot: str, output: Path | None, how: dict[str, Any], **options: Any) -> int:
    """A drive from the browser. Raises `InputError`."""
    if output is not None:
        check_apart([output], [Path(robot)])
        check_solution_output(output)
    if how["seconds"] is not None:
        require_positive("--seconds", how["seconds"], "s")
    from trajopt.view.driving.live import LiveDrive

    loaded = _robot(robot, how.pop("payload"))
    if loaded.base == "fixed" and not options["target"]:
        raise InputError(
            f"robot '{loaded.name}' has a fixed base", "allowed: with --target, an arm's tool follows"
        )
    with busy(f"preparing {loaded.name}"):
        live = LiveDrive(loaded, **options)
    with live, INTERRUPTION.deferring():
        say("Ctrl-C ends the drive", err=True)
        live.run(**how, leaving=lambda: INTERRUPTION.pressed)
        INTERRUPTION.answer()
        session = live.session
        if output is not None:
            session.as_drive().as_solution().save(output)
    passed, behind = session.driven.passed, session.clock.behind
    say(f"{loaded.name}: {passed:.1f} s simulated, {behind:.1f} s behind the clock")
    return 0


def _robot(name: str, payload: str | None) -> Robot:
    """The robot, with the mass of --payload. Raises `InputError`."""
    from trajopt.robot.catalogue import robot as load
    from trajopt.robot.payload import with_mass

    robot = load(name)
    if payload is None:
        return robot
    mass, *where = payload.split(",")
    at, *place = where or [robot.model.frames[-1].name if robot.base == "fixed" else robot.model.names[1]]
    try:
        numbers = [float(part) for part in (mass, *(place or ["0", "0", "0"]))]
    except ValueError:
        raise InputError(f"--payload is '{payload}'", "allowed: MASS[,FRAME[,X,Y,Z]], numbers") from None
    return with_mass(robot, numbers[0], at, numbers[1:])


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


def _posts(texts: tuple[str, ...]) -> list[Obstacle]:
    """Capsules upright on the ground, of each --post. Raises `InputError`."""
    import numpy as np

    from trajopt.collision import CapsuleObstacle

    posts: list[Obstacle] = []
    for number, text in enumerate(texts, 1):
        try:
            x, y, height, radius = (float(part) for part in text.split(","))
        except ValueError:
            raise InputError(f"--post is '{text}'", "allowed: X,Y,HEIGHT,RADIUS, numbers") from None
        if not height > 2 * radius > 0:
            raise InputError(f"--post is '{text}'", "allowed: a radius above 0, and a height above twice it")
        ends = np.array([[x, y, radius], [x, y, height - radius]])
        posts.append(CapsuleObstacle(name=f"post {number}", start=ends[0], end=ends[1], radius=radius))
    return posts


def _known(text: str) -> PiecewiseTerrain:
    """The ground of --terrain, ahead of the robot. Raises `InputError`."""
    from trajopt.control.mpc.hidden_ground import DISTANCE
    from trajopt.terrain.piecewise import PiecewiseTerrain
    from trajopt.terrain.reading import read_terrain

    ground = read_terrain(text, DISTANCE)
    if not isinstance(ground, PiecewiseTerrain):
        raise InputError(
            f"--terrain '{text}' is no ground of plane faces", "allowed: for smooth ground, solve"
        )
    return ground


def _ground(robot: Robot, slope: float | None, boxes: float | None, seed: int) -> PiecewiseTerrain | None:
    from trajopt.control.mpc.hidden_ground import boxes_ahead, slope_ahead

    if slope is not None:
        return slope_ahead(slope)
    return None if boxes is None else boxes_ahead(robot, boxes, seed)
