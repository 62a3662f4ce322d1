"""What tests of goals share: the objective at a guess, samples of a guess, a motion that moves everything."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.motion.solution import Solution
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.solving.extraction import extract
from trajopt.solving.solving import prepare
from trajopt.terms import Cost, NodeCost
from trajopt.transcription.schemes import scheme


def objective(problem: Problem, x: np.ndarray | None = None, **settings: object) -> float:
    """The NLP's objective at its guess, or at scaled unknowns."""
    prepared = prepare(problem, intervals=6, **settings)
    value = prepared.nlp.engine.f(prepared.guess if x is None else x)
    return float(value) * prepared.transcription.objective_unit


def with_terms(problem: Problem, *terms: object) -> Problem:
    """The problem with these costs alone."""
    kept = [term for term in problem.terms if not isinstance(term, Cost | NodeCost)]
    return replace(problem, terms=(*kept, *terms))


def wandering(robot: Robot):
    """A motion that moves and turns everything a little, around the reference."""
    rates = np.random.default_rng(1).uniform(-0.5, 0.5, (2, robot.nv))

    def motion(t: float) -> np.ndarray:
        return pin.integrate(robot.model, robot.reference, rates[0] * t + rates[1] * np.sin(5 * t))

    return motion


def sampled(problem: Problem) -> tuple[Solution, np.ndarray]:
    """The guess as samples, and as unknowns."""
    prepared = prepare(problem, intervals=6)
    return extract(prepared.transcription, prepared.guess), prepared.guess


def integral(solution: Solution, values: np.ndarray) -> float:
    """Integral over time of values at samples (K,), by the weights of the scheme's points."""
    weights = scheme(solution.statistics.transcription).b1
    spans = np.diff(solution.interval_t, axis=1).ravel()
    parts = [values[rows.start + 1 : rows.stop - 1] for rows in solution.intervals]
    return float(sum(h * weights @ part for h, part in zip(spans, parts, strict=True)))
