"""``trajopt discover``: schedules of contacts for a problem or a goal, found and certified."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import (
    NOT_REACHED,
    WholeNumber,
    default_option,
    json_option,
    parse_settings,
    value_option,
)
from trajopt.cli.report import console, plain_table, say, to_json
from trajopt.errors import InputError, expanded, not_among
from trajopt.motion.output import check_output, replacing

if TYPE_CHECKING:
    from collections.abc import Callable

    from trajopt.study.discovery.records import Candidate, Discovery
    from trajopt.study.discovery.task import ContactTask

SEEDS, MOST, JOBS = WholeNumber(0, 1000), WholeNumber(1, 1000), WholeNumber(1, 1024)
# Units of a goal; parameters of a cycle; largest number of either.
GOAL, CYCLE, FARTHEST = {"x": "m", "y": "m", "yaw": "rad"}, ("robot", "speed"), 1000.0
# Words in place of a robot's name, which is set then.
KINDS = ("quadruped", "biped")
OBSTACLES = {"box": "height", "gap": "width"}
GOAL_FORM = "allowed: --goal x=METRES, y=METRES or yaw=RADIANS, or --periodic --set speed=M/S"
TIME_FORM = "allowed: seconds, such as 1.5, or bounds, such as 1:2"


@click.command("discover")
@click.argument("problem")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter of the problem.")
@click.option(
    "--goal", multiple=True, metavar="NAME=VALUE", help="Of a robot: x, y in m, yaw in rad, to stand at."
)
@click.option("--periodic", is_flag=True, help="Of a robot: a cycle, with --set speed=M/S.")
@value_option(
    "--terrain",
    "KIND",
    "Of a robot: flat, box:height=M, gap:width=M, stairs:rise=M,run=M,steps=N ..., FILE.json.",
)
@value_option("--time", "SECONDS", "Of a robot: duration, or bounds LOW:HIGH.  [default: from the way]")
@default_option("--seeds", 4, "N", "Relaxed motions, from noise beside legs that stand.", kind=SEEDS)
@click.option("--no-known", is_flag=True, help="Without gaits, hops and steps that are known.")
@default_option(
    "--keep", 3, "N", "Schedules that are certified, of those about as good as the best.", kind=MOST
)
@default_option("--most", 12, "N", "Schedules that are tried until their motion holds, at most.", kind=MOST)
@default_option("--effort", 15.0, "RATIO", "Of all solves, over that of the easiest schedule.", kind=float)
@default_option("--max-time", 30.0, "SECONDS", "For each relaxed motion, and each schedule.", kind=float)
@value_option("--jobs", "N", "Processes.  [default: one for each processor]", JOBS)
@value_option("--scheduler", "ADDRESS", "Dask scheduler, e.g. tcp://127.0.0.1:8786.")
@value_option("--output-dir", "DIR", "Folder for the candidates.  [default: none]", Path)
@click.option("--resume", is_flag=True, help="Go on with the candidates of the folder.")
@value_option("--schedule-out", "FILE.py", "Write the best schedule as Python.", Path)
@value_option("--output", "FILE.npz", "Write the best motion.", Path)
@json_option
def discover_command(
    problem: str,
    settings: tuple[str, ...],
    goal: tuple[str, ...],
    periodic: bool,
    terrain: str | None,
    time: str | None,
    no_known: bool,
    output_dir: Path | None,
    resume: bool,
    schedule_out: Path | None,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> int:
    """Find who touches when, for PROBLEM, whose own phases are not used, or for the goal of a robot.

    Proposals come from relaxed contacts, from gaits, hops and steps that are known, and from neighbours of
    the best. All are solved with hard contacts and free durations on a coarse mesh, the best of them until
    their motion holds at any time. Exit status 0 where one does, 1 where none does.
    """
    from trajopt.study.discovery.proposals import nearest_gait
    from trajopt.study.discovery.search import discover, nearest_reached

    if resume and output_dir is None:
        raise InputError("--resume has no folder to go on with", "allowed: with --output-dir")
    if None not in (arguments["jobs"], arguments["scheduler"]):
        raise InputError("--jobs has no effect here", "allowed: without --scheduler")
    for path in (schedule_out, output):
        if path is not None:
            check_output(path)
    make = _tasks(problem, settings, goal, terrain, time, periodic=periodic)
    task, shown = make(1.0), console()

    def show(candidate: Candidate) -> None:
        if not as_json:
            what = candidate.why if candidate.objective is None else f"objective {candidate.objective:.5g}"
            line = f"{candidate.source:<16} {candidate.status:<10} {candidate.seconds:6.2f} s  {what}"
            shown.print(line, highlight=False)

    arguments["known"] = not no_known
    discovery = discover(task, folder=output_dir, resume=resume, on_candidate=show, **arguments)
    best = discovery.best
    modes = best[0].modes if best else None
    if modes is not None and schedule_out is not None:
        with replacing(expanded(schedule_out)) as path:
            path.write_text(modes.source())
    if best and output is not None and best[0].solution is not None:
        best[0].solution.save(output)
    if as_json:
        say(to_json(discovery.to_dict()))
    else:
        _print(discovery, None if modes is None else nearest_gait(task, modes))
    if not best and goal and not as_json:
        near = nearest_reached(make, **(arguments | {"seeds": min(arguments["seeds"], 2)}))
        reached = "none of a half, a quarter and an eighth of the way is reached"
        if near is not None:
            reached = f"{near[0]:g} of the way is reached: objective {near[1].best[0].objective:.5g}"
        shown.print(reached)
    return 0 if best else NOT_REACHED


def _tasks(
    problem: str,
    settings: tuple[str, ...],
    goal: tuple[str, ...],
    terrain: str | None,
    time: str | None,
    *,
    periodic: bool,
) -> Callable[[float], ContactTask]:
    """The task of a part of the way to the goal."""
    from trajopt.problem.catalogue import families
    from trajopt.problem.family import choose
    from trajopt.robot.catalogue import robot as load_robot
    from trajopt.study.discovery.goal import Destination, first_edge, obstacle, task_to
    from trajopt.study.discovery.task import ContactTask
    from trajopt.terrain.reading import read_terrain

    if problem in families():
        named = {"--goal": goal, "--terrain": terrain, "--time": time, "--periodic": periodic}
        for name, given in named.items():
            if given:
                raise InputError(
                    f"{name} has no effect on the problem '{problem}'", "allowed: --set, or a robot's name"
                )
        task = ContactTask.of(choose(families(), problem).load(parse_settings(settings, "--set")))
        return lambda _: task
    low, high = _span(time)
    if periodic:
        task = _cycle(problem, settings, (low, high), {"--goal": goal, "--terrain": terrain})
        return lambda _: task
    if settings:
        raise InputError(
            f"--set has no effect on the robot '{problem}'", "allowed: --goal, or a problem's name"
        )
    robot = load_robot(problem)
    asked = parse_settings(goal, "--goal")
    for name in asked:
        if name not in GOAL:
            raise not_among(GOAL, name, f"a goal has no '{name}'")
    values = {name: _number(name, text, GOAL[name]) for name, text in asked.items()}
    span = None if low == high else (low, high)
    kind, _, size = (terrain or "flat").partition(":")
    name, _, text = size.partition("=")
    extent, ground = None, None
    if OBSTACLES.get(kind) == name and "," not in text:
        extent = _number(name, text)
    elif terrain and terrain != "flat":
        ground = read_terrain(terrain, first_edge(robot))
    if not goal:
        raise InputError(f"the robot '{problem}' has no goal", GOAL_FORM)

    def make(part: float) -> ContactTask:
        way = {name: part * value for name, value in values.items()}
        place = Destination(**way, duration=(low + high) / 2 if high else None, duration_range=span)
        return task_to(robot, place, ground if extent is None else obstacle(robot, kind, extent, place))

    return make


def _cycle(
    name: str, settings: tuple[str, ...], span: tuple[float, float], unused: dict[str, Any]
) -> ContactTask:
    """A cycle of a robot, by its name or as ``--set robot=`` of a kind."""
    from trajopt.robot.catalogue import robot as load_robot
    from trajopt.study.discovery.goal import cycle_of

    for option, given in unused.items():
        if given:
            raise InputError(f"{option} has no effect on a cycle", "allowed: --set speed=M/S, --time")
    values = parse_settings(settings, "--set")
    for key in values:
        if key not in CYCLE:
            raise not_among(CYCLE, key, f"a cycle has no '{key}'")
    if "speed" not in values:
        raise InputError("a cycle has no speed", "allowed: --set speed=M/S")
    if span[0] != span[1]:
        raise InputError(f"the period of a cycle is {span[0]:g} to {span[1]:g} s", "allowed: one number")
    if (name in KINDS) != ("robot" in values):
        raise InputError(
            f"the robot of '{name}' is not clear", f"allowed: its name, or {KINDS[0]} --set robot=NAME"
        )
    speed = _number("speed", values["speed"], "m/s")
    return cycle_of(load_robot(values.get("robot", name)), speed, span[1] or None)


def _number(name: str, text: str, unit: str = "m") -> float:
    """A number, which may carry its unit; raises `InputError`."""
    from trajopt.problem.family import Parameter

    parameter = Parameter(name=name, default=None, unit=unit, lower=-FARTHEST, upper=FARTHEST, meaning=name)
    return parameter.parse(text)


def _span(text: str | None) -> tuple[float, float]:
    """Least and greatest duration, s; 0 and 0 without one."""
    if text is None:
        return 0.0, 0.0
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 2) or not all(0 < part < math.inf for part in parts) or parts != sorted(parts):
        raise InputError(f"--time is '{text}'", TIME_FORM)
    return parts[0], parts[-1]


def _print(discovery: Discovery, gait: tuple[str, float] | None) -> None:
    shown = console()
    if discovery.task.left_out:
        shown.print(
            f"no part of the task, since bound to its own phases: {', '.join(discovery.task.left_out)}"
        )
    if not discovery.best:
        shown.print(f"no schedule was found, in {discovery.seconds:.1f} s of solvers")
        return
    rows = [
        [each.source, f"{each.objective:.5g}", str(len(each.modes.modes)), str(each.modes)]
        for each in discovery.best[:3]
        if each.modes is not None
    ]
    shown.print(plain_table(("best", "objective", "phases", "contacts"), rows))
    if gait is not None:
        shown.print(f"nearest known gait of the best: {gait[0]}, {100 * gait[1]:.0f} % of a period away")
    shown.print(f"{len(discovery.candidates)} candidates, {discovery.seconds:.1f} s of solvers")
