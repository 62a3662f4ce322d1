"""Obstacles for any problem: which pairs become rows, and a solve that adds what it missed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.certify.report import PENETRATION
from trajopt.errors import InputError, require_not_negative
from trajopt.problem.problem import Problem
from trajopt.robot.collision.link_capsules import robot_capsules
from trajopt.robot.collision.near import CollisionScene, ShapePair, separable_pairs
from trajopt.robot.collision.shapes import LinkCapsule, Obstacle
from trajopt.schedule.schedule import Schedule
from trajopt.solution.clearance import refined_configurations
from trajopt.solution.solution import Solution
from trajopt.solving.solving import solve
from trajopt.terms.clearance import Clearance, collision_scene

# Pairs nearer than this along the guess become rows, over the robot's length. A motion that leaves its guess
# by more comes near other pairs, which `solve_clear` adds.
BAND = 0.2
# Samples of the guess: a tool that crosses the robot's length moves a twentieth of it between two.
LOOKS = 40
# `solve_clear` gives up after this many solves: each adds a pair or halves the steps.
MOST_SOLVES = 5


def with_obstacles(
    problem: Problem,
    obstacles: Sequence[Obstacle],
    *,
    margin: float = 0.0,
    capsules: Sequence[LinkCapsule] | None = None,
    self_collision: bool = False,
    band: float | None = None,
) -> Problem:
    """Return the problem with its robot kept away from obstacles, and from itself if asked.

    Links that overlap in the robot's reference posture are not kept apart.

    Args:
        problem: The problem without obstacles.
        obstacles: In the world.
        margin: Least distance, m.
        capsules: Of the robot; default: those of `robot_capsules`. Those fixed to the world are left out.
        self_collision: Keep the robot's links apart, too.
        band: Pairs that come nearer than ``margin`` + ``band`` m along the problem's guess, phase by phase,
            become constraints; default: `BAND` of the robot's length.

    Raises:
        InputError: Where the fixed start is nearer to an obstacle than ``margin``.
    """
    robot, model = problem.robot, problem.robot.model
    given = tuple(robot_capsules(robot) if capsules is None else capsules)
    moving = tuple(c for c in given if model.frames[_frame(model, c.frame)].parentJoint > 0)
    pairs = separable_pairs(model, moving, robot.reference, margin) if self_collision else ()
    scene = CollisionScene(model=model, capsules=moving, obstacles=tuple(obstacles), self_pairs=pairs)
    reach = BAND * robot.length if band is None else band
    require_not_negative("band around obstacles", reach, "m")
    _require_clear_start(problem, scene, margin)
    terms: list[Clearance] = []
    start = 0.0
    for phase in problem.schedule.phases:
        times = start + np.linspace(0.0, phase.duration, LOOKS + 1)
        near = scene.near([problem.guess(float(t)) for t in times], margin + reach)
        terms.append(Clearance(scene=scene, pairs=near, margin=margin, phases=(phase.name,)))
        start += phase.duration
    return replace(problem, terms=(*problem.terms, *terms))


def _frame(model: pin.Model, name: str) -> int:
    if not model.existFrame(name):
        raise InputError(f"a capsule is on frame '{name}', which does not exist", "allowed: its frames")
    return int(model.getFrameId(name))


def _require_clear_start(problem: Problem, scene: CollisionScene, margin: float) -> None:
    if not scene.pairs:
        return
    distances = scene.distances(problem.initial_q)
    worst = int(np.argmin(distances))
    if distances[worst] < margin:
        first, second = scene.pairs[worst]
        raise InputError(
            f"'{first}' starts {distances[worst]:.4f} m from '{second}'", f"allowed: at least {margin:g} m"
        )


def missed_pairs(problem: Problem, solution: Solution) -> dict[str, tuple[ShapePair, ...]]:
    """By phase, pairs without a row that come nearer than the margin in a solution, by Coal."""
    missed = {}
    for phase, rows in zip(problem.schedule.phases, solution.phases, strict=True):
        for term in problem.terms:
            if isinstance(term, Clearance) and term.acts_in(phase.name):
                near = term.scene.near(refined_configurations(solution, rows), term.margin)
                new = tuple(pair for pair in near if pair not in term.pairs)
                if new:
                    missed[phase.name] = new
    return missed


def solve_clear(problem: Problem, **options: Any) -> tuple[Solution, Problem]:
    """Solve, and solve again where Coal finds the motion too near to something; options as for `solve`.

    Pairs that came too near without a row get one, and the motion found is the next guess. Where rows hold at
    the points but not between them, e.g. for a link that passes a post within one step, the number of
    intervals is doubled, and the guess stays. Returns the last solution and the problem it solves.
    """
    solution = solve(problem, **options)
    for _ in range(MOST_SOLVES - 1):
        missed = missed_pairs(problem, solution)
        if missed:
            problem = _again(problem, solution, missed)
        elif solution.converged and _least(problem, solution) < -PENETRATION:
            options = {**options, "intervals": 2 * solution.n_intervals}
        else:
            break
        solution = solve(problem, **options)
    return solution, problem


def _least(problem: Problem, solution: Solution) -> float:
    scene = collision_scene(problem.terms)
    if scene is None:
        return math.inf
    return float(scene.least_distances(refined_configurations(solution)).min(initial=math.inf))


def _again(problem: Problem, solution: Solution, missed: Mapping[str, tuple[ShapePair, ...]]) -> Problem:
    """The problem with rows for missed pairs, and with a solution's motion and durations as its guess."""
    terms = tuple(_with_pairs(t, missed) if isinstance(t, Clearance) else t for t in problem.terms)
    phases = tuple(
        replace(phase, duration=float(np.clip(duration, *phase.duration_bounds)))
        if phase.duration_bounds
        else phase
        for phase, duration in zip(problem.schedule.phases, solution.meta["durations"], strict=True)
    )
    return replace(problem, terms=terms, schedule=Schedule(phases), guess=solution.interpolate)


def _with_pairs(term: Clearance, missed: Mapping[str, tuple[ShapePair, ...]]) -> Clearance:
    new = [pair for phase, pairs in missed.items() if term.acts_in(phase) for pair in pairs]
    return replace(term, pairs=(*term.pairs, *new))
