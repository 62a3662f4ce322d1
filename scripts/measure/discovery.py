"""Schedules that are found: against the library's own, by speed, for random goals, from random starts."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.stats import spearmanr

import trajopt
from scripts.measure.shared import head, named, row
from trajopt.discovery import Destination, Discovery, discover, relaxation, task_to
from trajopt.discovery.goal import obstacle
from trajopt.discovery.proposals import known_proposals, nearest_gait, relaxed_proposal
from trajopt.discovery.records import CERTIFIED
from trajopt.discovery.task import ContactTask
from trajopt.discovery.trials import certified, screened, spent
from trajopt.dynamics import gravity_of
from trajopt.errors import InputError
from trajopt.motion.energy_use import cost_of_transport
from trajopt.problem.problem import Problem
from trajopt.reduced.single_rigid_body import body_problem
from trajopt.reduced.two_stage import standing_share
from trajopt.solving.solving import solve as solve_on_mesh
from trajopt.terms.costs import TorqueCost, WrenchCost
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
# Of `discovery-slacks`.
SEQUENCES = ((0.3, 0.1, 0.03, 0.01, 0.003), (0.3, 0.03, 0.003), (0.1, 0.03, 0.01, 0.003), (0.1, 0.005))
SLACK_TASKS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("quadruped-trot", {"robot": "go2"}),
    ("quadruped-trot", {"robot": "solo12", "speed": 1.2}),
    ("hopper-hop", {}),
    ("quadruped-box-up", {"robot": "go2"}),
    ("quadruped-gap", {"robot": "solo12"}),
)
SORTED_TASKS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("quadruped-trot", {"robot": "solo12", "speed": 0.29}),
    ("quadruped-trot", {"robot": "go2", "speed": 1.4}),
    ("quadruped-box-up", {"robot": "go2"}),
    ("quadruped-gap", {"robot": "solo12"}),
    ("quadruped-stand-up", {"robot": "go2"}),
)
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
    head(
        "problem",
        "own cost",
        "found cost",
        "ratio",
        "from",
        "nearest gait",
        "phases",
        "candidates",
        "solvers over own: time",
        "iterations times variables",
    )
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
    row(
        label,
        f"{cost:.4g}",
        f"{best.objective:.4g}",
        f"{best.objective / cost:.2f}",
        best.source,
        "" if gait is None else f"{gait[0]} ({100 * gait[1]:.0f} %)",
        len(best.modes.modes),
        count,
        *ratios,
    )


@click.command("gaits-by-speed")
@click.option("--robot", default="go2")
@click.option("--figure", type=Path, help="Also draw it.")
def gaits_by_speed(robot: str, figure: Path | None) -> None:
    """Cost of transport over speed, of the gait with the least torques that was found."""
    head(
        "speed over sqrt(g l)",
        "Froude number",
        "cost of transport",
        "objective",
        "gait",
        "duty factors",
        "from",
        "next best",
    )
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
        row(
            relative,
            f"{relative**2:.2g}",
            f"{transport[0]:.3f}",
            f"{best.objective:.3f}",
            f"{gait[0]} ({100 * gait[1]:.0f} %)",
            f"{duty[0]:.2f} to {duty[-1]:.2f}",
            best.source,
            f"{other[0].source}, {transport[1]:.3f}, {other[0].objective:.3f}" if other else "",
        )
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
    for relative, label in (
        (math.sqrt(0.5), "walk to trot, Fr 0.5"),
        (math.sqrt(2.5), "trot to gallop, Fr 2.5"),
    ):
        axes.axvline(relative, color="0.6", linestyle="--", linewidth=0.8)
        axes.text(relative, axes.get_ylim()[1], f" {label}", fontsize=7, va="top", rotation=90, ha="right")
    axes.set(
        xlabel="speed over sqrt(g l)",
        ylabel="cost of transport",
        title=f"Gaits that were found, {robot}",
        ylim=(0, None),
    )
    axes.legend(frameon=False)
    figure.savefig(path)


@click.command("discovery-sorters")
def sorters() -> None:
    """What tells good schedules from bad ones before they are certified: rank correlation with their cost."""
    head(
        "problem",
        "known schedules",
        "coarse mesh",
        "single rigid body",
        "likeness to a relaxed motion",
        "solver time over that of the first mesh: coarse mesh",
        "single rigid body",
    )
    for name, values in SORTED_TASKS:
        task = ContactTask.of(problems.load(name, **values))
        relaxed = relaxed_proposal(task, 1, 30.0)
        figures: list[list[float]] = []
        seconds = np.zeros(3)
        for proposal in known_proposals(task):
            if proposal.modes is None or proposal.motion is None:
                continue
            problem = task.with_modes(proposal.modes, proposal.motion)
            draft = trajopt.solve(problem, draft=True, max_time=30.0)
            coarse = screened(task, proposal, 30.0)
            body = solve_on_mesh(_body(problem), intervals=problem.default_intervals // 3, judge=False)
            seconds += spent(draft)[0], coarse.seconds, spent(body)[0]
            away = math.nan if relaxed.modes is None else relaxed.modes.apart(proposal.modes)
            solved = [each.statistics.objective if each.converged else math.inf for each in (draft, body)]
            figures.append(
                [solved[0], math.inf if coarse.screened is None else coarse.screened, solved[1], away]
            )
        cost, *others = np.array(figures).T
        ranks = [float(spearmanr(cost, other).statistic) for other in others]
        label = named(
            name, {key: value if isinstance(value, str) else f"{value:.2g}" for key, value in values.items()}
        )
        row(
            label,
            len(figures),
            *(f"{rank:.2f}" for rank in ranks),
            *(f"{s:.2f}" for s in seconds[1:] / seconds[0]),
        )


def _body(problem: Problem) -> Problem:
    """The problem of one rigid body, with wrenches that cost what torques do in standing still."""
    body = body_problem(replace(problem, periodicity=None))
    share = standing_share(problem.robot)
    costs = (WrenchCost(weight=share * term.weight) for term in problem.terms if isinstance(term, TorqueCost))
    return replace(body, terms=(*body.terms, *costs), periodicity=problem.periodicity)


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
                missed.append(
                    f"{goal.x:.2f}, {goal.y:.2f} m" + (f", box {height:.2f} m" if box < 0.5 else "")
                )
        solved = [each for each in results if each.best]
        relaxed = sum(each.best[0].source.startswith("relaxed") for each in solved)
        seconds = float(np.median([each.seconds for each in results]))
        row(name, count, len(solved), relaxed, f"{seconds:.1f}", "; ".join(missed))


@click.command("discovery-starts")
@click.option("--starts", default=10)
def starts(starts: int) -> None:
    """Spread of the cost that is found from random starts of the same task."""
    head(
        "problem",
        "certified",
        "least cost",
        "median",
        "largest",
        "different schedules",
        "solvers [s], median",
    )
    for name, values in (
        ("quadruped-trot", {"robot": "go2"}),
        ("hopper-hop", {}),
        ("quadruped-box-up", {"robot": "go2"}),
    ):
        problem: Problem = problems.load(name, **values)
        task = ContactTask.of(problem)
        candidates = []
        for seed in range(1, starts + 1):
            proposal = relaxed_proposal(task, seed, 30.0)
            if proposal.modes is not None:
                candidates.append(certified(task, proposal, 30.0))
        costs = sorted(each.objective for each in candidates if each.objective is not None)
        different = {
            each.modes.key for each in candidates if each.objective is not None and each.modes is not None
        }
        seconds = float(np.median([each.seconds for each in candidates]))
        figures = (
            [f"{value:.4g}" for value in (costs[0], float(np.median(costs)), costs[-1])]
            if costs
            else [""] * 3
        )
        row(
            " ".join([name, *values.values()]),
            f"{len(costs)} of {starts}",
            *figures,
            len(different),
            f"{seconds:.1f}",
        )


@click.command("discovery-slacks")
def slacks() -> None:
    """Proposals that are certified, by the slacks of the relaxed solves: five tasks, two starts each."""
    head("slacks", "certified, of ten", "solvers of all [s]")
    usual = relaxation.SLACKS
    for sequence in SEQUENCES:
        relaxation.SLACKS = sequence
        count, seconds = 0, 0.0
        for name, values in SLACK_TASKS:
            task = ContactTask.of(problems.load(name, **values))
            for seed in range(2):
                proposal = relaxed_proposal(task, seed, 20.0)
                candidate = None if proposal.modes is None else certified(task, proposal, 20.0)
                count += candidate is not None and candidate.status == CERTIFIED
                seconds += proposal.seconds if candidate is None else candidate.seconds
        row(", ".join(f"{slack:g}" for slack in sequence), count, f"{seconds:.0f}")
    relaxation.SLACKS = usual
