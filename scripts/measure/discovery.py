"""Schedules that are found: against the library's own, by speed, for random goals."""

import math
from pathlib import Path
from typing import Any

import click
import numpy as np

import trajopt
from scripts.measure.shared import head, named, row
from trajopt.dynamics import gravity_of
from trajopt.errors import InputError
from trajopt.motion.energy_use import cost_of_transport
from trajopt.study.discovery import Destination, Discovery, discover, task_to
from trajopt.study.discovery.goal import obstacle
from trajopt.study.discovery.proposals import nearest_gait
from trajopt.study.discovery.trials import spent
from trajopt_library import problems, robots

SPEEDS = (0.2, 0.5, 0.8, 1.2)
# Problems beside trots at these speeds, over sqrt(g l).
TASKS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("hopper-hop", {}),
    ("biped-gait", {"robot": "bolt"}),
    ("biped-gait", {"robot": "g1"}),
    ("biped-gait", {"robot": "talos"}),
    ("quadruped-box-up", {"robot": "go2"}),
    ("quadruped-box-down", {"robot": "go2"}),
    ("quadruped-gap", {"robot": "solo12"}),
    ("quadruped-stand-up", {"robot": "go2"}),
)
GAIT_SPEEDS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.05, 1.2)
# Of random goals: over the robot's length, and rad; a box of a height, or level ground.
ROBOTS = ("go2", "solo12", "anymal_c")
WAY, ASIDE, TURN, HEIGHT = (0.3, 2.0), 0.3, 0.5, (0.1, 0.4)


def speed_of(robot: str, relative: float) -> float:
    """A speed over sqrt(g l), m/s."""
    body = robots.load(robot)
    return relative * math.sqrt(gravity_of(body.model) * body.length)


@click.command("discovery")
@click.option("--seeds", default=3, help="Relaxed motions of each.")
def discovery(seeds: int) -> None:
    """Cost of the best schedule that is found over that of the library's own, and what it takes."""
    best = ("found cost", "ratio", "from", "nearest gait", "phases", "candidates")
    head("problem", "own cost", *best, "solvers over own: time", "iterations times variables")
    trots = [
        ("quadruped-trot", {"robot": robot, "speed": speed_of(robot, speed)})
        for robot in ("go2", "solo12")
        for speed in SPEEDS
    ]
    for name, values in (*TASKS, *trots):
        problem = problems.load(name, **values)
        own = trajopt.solve(problem, max_time=60.0)
        found = discover(problem, seeds=seeds)
        cycles = found.task.duration / problem.schedule.duration
        shown = {key: f"{value:.2g}" if isinstance(value, float) else value for key, value in values.items()}
        label = named(name, shown)
        _row(label, found, cycles * (own.statistics.objective or math.nan), spent(own))


def _row(label: str, found: Discovery, cost: float, own: tuple[float, float]) -> None:
    count = f"{len(found.best)} of {len(found.candidates)}"
    ratios = f"{found.seconds / own[0]:.0f}", f"{found.effort / own[1]:.0f}"
    if not found.best:
        row(label, f"{cost:.4g}", "none", "", "", "", "", count, *ratios)
        return
    best = found.best[0]
    assert best.objective is not None
    assert best.modes is not None
    gait = nearest_gait(found.task, best.modes)
    costs = f"{cost:.4g}", f"{best.objective:.4g}", f"{best.objective / cost:.2f}"
    nearest = "" if gait is None else f"{gait[0]} ({100 * gait[1]:.0f} %)"
    row(label, *costs, best.source, nearest, len(best.modes.modes), count, *ratios)


@click.command("gaits-by-speed")
@click.option("--robot", default="go2")
@click.option("--figure", type=Path, help="Also draw it.")
def gaits_by_speed(robot: str, figure: Path | None) -> None:
    """Cost of transport over speed, of the gait with the least torques that was found."""
    gaits = ("cost of transport", "objective", "gait", "duty factors", "from", "next best")
    head("speed over sqrt(g l)", "Froude number", *gaits)
    points = []
    for relative in GAIT_SPEEDS:
        problem = problems.load("quadruped-trot", robot=robot, speed=speed_of(robot, relative))
        found = discover(problem, seeds=3, max_time=15.0, effort=60.0)
        if not found.best:
            row(relative, f"{relative**2:.2g}", "none", "", "", "", "", "")
            continue
        best, other = found.best[0], found.best[1:2]
        assert best.modes is not None
        gait = nearest_gait(found.task, best.modes) or ("", 0.0)
        duty = sorted(best.modes.duty().values())
        transport = [cost_of_transport(each.solution) for each in found.best[:2] if each.solution]
        points.append((relative, transport[0], gait[0]))
        costs = f"{relative**2:.2g}", f"{transport[0]:.3f}", f"{best.objective:.3f}"
        steps = f"{gait[0]} ({100 * gait[1]:.0f} %)", f"{duty[0]:.2f} to {duty[-1]:.2f}"
        after = f"{other[0].source}, {transport[1]:.3f}, {other[0].objective:.3f}" if other else ""
        row(relative, *costs, *steps, best.source, after)
    if figure is not None:
        _draw(points, robot, figure)


def _draw(points: list[tuple[float, float, str]], robot: str, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    x, y = ([point[k] for point in points] for k in (0, 1))
    axes.plot(x, y, color="0.7", zorder=1)
    for gait in dict.fromkeys(point[2] for point in points):
        own = [point for point in points if point[2] == gait]
        axes.scatter([p[0] for p in own], [p[1] for p in own], label=gait, zorder=2)
    for froude, gaits in ((0.5, "walk to trot"), (2.5, "trot to gallop")):
        relative, label = math.sqrt(froude), f"{gaits}, Fr {froude}"
        axes.axvline(relative, color="0.6", linestyle="--", linewidth=0.8)
        axes.text(relative, axes.get_ylim()[1], f" {label}", fontsize=7, va="top", rotation=90, ha="right")
    axes.set(xlabel="speed over sqrt(g l)", ylabel="cost of transport", ylim=(0, None))
    axes.set_title(f"Gaits that were found, {robot}")
    axes.legend(frameon=False)
    figure.savefig(path)


@click.command("discovery-goals")
@click.option("--count", default=10, help="Goals of each robot.")
@click.option("--seed", default=1)
def goals(count: int, seed: int) -> None:
    """Random goals in reach of each robot, on level ground or on a box: how many are certified."""
    head("robot", "goals", "certified", "best from relaxed contacts", "solvers [s], median", "not certified")
    for name in ROBOTS:
        rng, robot = np.random.default_rng(seed), robots.load(name)
        results, missed = [], []
        while len(results) < count:
            way, aside, turn, box, high = rng.uniform(size=5)
            goal = Destination(
                x=float(np.interp(way, (0, 1), WAY)) * robot.length,
                y=(2 * aside - 1) * ASIDE * robot.length,
                yaw=(2 * turn - 1) * TURN,
            )
            height = float(np.interp(high, (0, 1), HEIGHT)) * robot.length
            try:
                task = task_to(robot, goal, obstacle(robot, "box", height, goal) if box < 0.5 else None)
            except InputError:  # no posture there by inverse kinematics: not reachable
                continue
            found = discover(task, seeds=3, most=4, max_time=15.0, jobs=None)
            results.append(found)
            if not found.best:
                ahead = f", box {height:.2f} m" if box < 0.5 else ""
                missed.append(f"{goal.x:.2f}, {goal.y:.2f} m{ahead}")
        solved = [each for each in results if each.best]
        relaxed = sum(each.best[0].source.startswith("relaxed") for each in solved)
        seconds = float(np.median([each.seconds for each in results]))
        row(name, count, len(solved), relaxed, f"{seconds:.1f}", "; ".join(missed))
