"""Receding-horizon control in MuJoCo, in lockstep with the delay of its solves (docs/mpc.md)."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import click
import numpy as np

from scripts.measure.shared import head, row
from trajopt.control.mpc import Command, CommandScript, Controller, ControllerSettings, PlannerSettings
from trajopt.dynamics import gravity_of
from trajopt.robot import Robot
from trajopt.robot.natural_units import NaturalUnits
from trajopt.simulation import DrivenMotion, Impulse, drive
from trajopt_library import robots

QUADRUPEDS, BIPEDS = ("go2", "solo12", "anymal_c"), ("g1", "talos")
GAITS = ("walk", "trot", "pace", "bound", "pronk")
# Ranges of speeds over that of Go2, and steps of the random walk each second.
LOW, HIGH, STEP = np.array([-0.5, -0.3, -1.0]), np.array([1.0, 0.3, 1.0]), np.array([0.4, 0.2, 0.6])
START = 0.3
# Commands of bipeds over those of quadrupeds.
SLOW = 0.25
names_option = click.option(
    "--robots", "names", default=",".join(QUADRUPEDS), metavar="A,B", show_default=True
)
seconds_option = click.option("--seconds", default=60.0, show_default=True, help="Of each drive.")
seeds_option = click.option("--seeds", default=5, show_default=True, help="Number of seeds.")


def scale_of(robot: Robot) -> float:
    """Speeds of a robot over those of Go2: sqrt(g l)."""
    return math.sqrt(robot.length / robots.load("go2").length)


def random_walk(robot: Robot, gait: str, seconds: float, seed: int) -> CommandScript:
    """Commands that change each second."""
    generator, slow = np.random.default_rng(seed), SLOW if robot.name in BIPEDS else 1.0
    factor = slow * scale_of(robot)
    at, times, commands = np.zeros(3), [0.0], [Command()]
    for time in np.arange(0.5, seconds, 1.0):
        at = np.clip(at + STEP * generator.standard_normal(3), LOW, HIGH)
        times.append(float(time))
        speed, lateral, turn = (at * [factor, factor, slow]).tolist()
        commands.append(Command(gait=gait, speed=speed, lateral=lateral, turn_rate=turn))
    return CommandScript(tuple(times), tuple(commands))


def gait_of_robot(robot: Robot) -> str:
    """A trot, of bipeds a walk."""
    return "walk" if robot.name in BIPEDS else "trot"


def straight(gait: str, speed: float) -> CommandScript:
    """From a stance straight ahead."""
    return CommandScript((0.0, START), (Command(), Command(gait=gait, speed=speed)))


def usual_speed(robot: Robot) -> float:
    """Of a trot, of bipeds of a walk, m/s."""
    part = 0.08 if robot.name in BIPEDS else 0.4
    return part * math.sqrt(gravity_of(robot.model) * robot.length)


def impulse(robot: Robot, direction: float, size: float, time: float) -> Impulse:
    """A level impulse at ``time`` s to a direction in rad, natural units."""
    units = NaturalUnits.of(robot.model)
    size *= units.weight * units.time
    return Impulse(direction=direction, size=size, time=time, duration=0.1 * units.time)


def random_pushes(robot: Robot, size: float, seconds: float, seed: int) -> tuple[Impulse, ...]:
    """Impulses each 3 s, each to a random side, natural units."""
    generator = np.random.default_rng(100 + seed)
    times = np.arange(3.0, seconds - 1.0, 3.0) + generator.uniform(0.0, 1.0)
    sides = generator.uniform(-math.pi, math.pi, len(times))
    both = zip(times.tolist(), sides.tolist(), strict=True)
    return tuple(impulse(robot, side, size, time) for time, side in both)


def survived(
    robot: Robot,
    degrees: float,
    sizes: Sequence[float],
    time: float,
    lasts: float,
    make: Callable[[], Controller],
) -> float:
    """The largest of rising impulses at ``time`` s before the first fall, natural units, at a usual speed.

    A drive lasts ``lasts`` s, with a new controller that ``make`` returns.
    """
    best = 0.0
    for size in sizes:
        push = impulse(robot, math.radians(degrees), size, time)
        script = straight(gait_of_robot(robot), usual_speed(robot))
        if drive(robot, script, duration=lasts, controller=make(), pushes=(push,)).report.fell:
            break
        best = size
    return best


def cells(run: DrivenMotion) -> list[str]:
    """Whether it fell, errors of commands, and times."""
    report, errors = run.report, run.report.mean_errors
    tracked = ["", "", ""]
    if errors is not None:
        tracked = [f"{e:.3f}" for e in (errors.speed, errors.lateral, errors.turn_rate)]
    times = (f"{1e3 * time:.1f}" for time in (report.plan_times.median, report.plan_times.p99))
    fell = f"fell at {report.fall_time:.1f} s" if report.fell else "no"
    return [fell, *tracked, *times, str(report.begun_anew)]


TITLES = ("fell", "speed, m/s", "lateral, m/s", "turn, rad/s", "plan, ms", "99 %, ms", "begun anew")


@click.command("commands")
@names_option
@seconds_option
@seeds_option
@click.option("--gait", default="", help="Default: trot, of bipeds walk.")
@click.option("--fixed", is_flag=True, help="Durations are those of the gait.")
def commands(names: str, seconds: float, seeds: int, gait: str, fixed: bool) -> None:
    """Follow commands that change each second by a random walk; errors are root mean squares."""
    head("robot", "seed", *TITLES)
    settings = ControllerSettings(planner=PlannerSettings(timing=0.0)) if fixed else None
    for name in names.split(","):
        robot = robots.load(name)
        for seed in range(seeds):
            script = random_walk(robot, gait or gait_of_robot(robot), seconds, seed)
            row(name, str(seed), *cells(drive(robot, script, duration=seconds, settings=settings)))


@click.command("bipeds")
@click.option("--robots", "names", default=",".join(BIPEDS), metavar="A,B", show_default=True)
@click.option("--seconds", default=20.0, show_default=True, help="Of each drive.")
@seeds_option
@click.option("--push", default=0.1, show_default=True, help="Impulse each 3 s, natural units.")
def bipeds(names: str, seconds: float, seeds: int, push: float) -> None:
    """Bipeds on soles follow commands that change each second, pushed each 3 s from a random side."""
    head("robot", "seed", *TITLES)
    for name in names.split(","):
        robot = robots.load(name)
        for seed in range(seeds):
            pushes = random_pushes(robot, push, seconds, seed)
            script = random_walk(robot, "walk", seconds, seed)
            row(name, str(seed), *cells(drive(robot, script, duration=seconds, pushes=pushes)))


@click.command("pushed")
@names_option
@click.option("--most", default=0.8, show_default=True, help="Largest impulse, natural units.")
@click.option("--step", default=0.1, show_default=True)
@click.option("--least", default=0.2, show_default=True, help="The first that is tried.")
@click.option("--directions", default=8, show_default=True)
def pushed(names: str, most: float, step: float, least: float, directions: int) -> None:
    """Largest impulse before the first that a robot falls by, trotting (bipeds: walking), by direction.

    With durations of the gait, and free ones.
    """
    angles = [round(360 * k / directions) for k in range(directions)]
    sizes = np.arange(least, most + step / 2, step).tolist()
    head("robot", "unit, N s", "durations", *map(str, angles), "least")
    for name in names.split(","):
        robot = robots.load(name)
        units = NaturalUnits.of(robot.model)
        for title, planner in (("fixed", PlannerSettings(timing=0.0)), ("free", PlannerSettings())):
            make = partial(Controller, robot, (gait_of_robot(robot),), ControllerSettings(planner=planner))
            time = START + 4.0 * 2.6 * math.sqrt(robot.length / gravity_of(robot.model))
            lasts = time + 6 * units.time
            largest = [survived(robot, angle, sizes, time, lasts, make) for angle in angles]
            unit = units.weight * units.time
            row(name, f"{unit:.3g}", title, *(f"{size:.2g}" for size in largest), f"{min(largest):.2g}")


@click.command("gait-changes")
@names_option
@seeds_option
def gait_changes(names: str, seeds: int) -> None:
    """From a stance through all gaits and back, at random moments, at a third of the trot's usual speed."""
    head("robot", "seed", *TITLES)
    for name in names.split(","):
        robot = robots.load(name)
        speed = 0.15 * math.sqrt(gravity_of(robot.model) * robot.length)
        for seed in range(seeds):
            generator = np.random.default_rng(seed)
            order = (*GAITS, *GAITS[-2::-1])
            times = np.cumsum([START, *generator.uniform(1.0, 2.0, len(order))]).tolist()
            given = [Command(), *(Command(gait=gait, speed=speed) for gait in order), Command()]
            script = CommandScript((0.0, *times), tuple(given))
            row(name, str(seed), *cells(drive(robot, script, duration=times[-1] + 1.5)))
