"""What the rest of effort and the rounding of power cost and give: tables of docs/modelling/objectives.md.

uv run python -m scripts.compare_goals
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trajopt.certify.check import check
from trajopt.certify.energy import cost_of_transport
from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.solving import solve
from trajopt.terms import Cost, PowerCost, TimeCost
from trajopt.terms.objectives import REST_OF_LINEAR
from trajopt_library import problems

# Starts beside a problem's own guess, with the suite's noise in natural units.
SEEDS, NOISE = (0, 1, 2), 0.1
RESTS = (0.3, REST_OF_LINEAR, 0.03, 0.01)
ROUNDINGS = (0.3, 0.1, 0.03, 0.01)


def with_rest(problem: Problem, rest: float) -> Problem:
    """A problem with a linear goal and another part of the costs of effort."""
    share = rest / REST_OF_LINEAR
    terms = [
        replace(term, weight=share * term.weight)
        if isinstance(term, Cost) and not isinstance(term, TimeCost)
        else term
        for term in problem.terms
    ]
    return replace(problem, terms=tuple(terms))


def rounded(problem: Problem, smoothing: float) -> Problem:
    """The problem with power rounded over another width."""
    terms = [
        replace(term, smoothing=smoothing) if isinstance(term, PowerCost) else term for term in problem.terms
    ]
    return replace(problem, terms=tuple(terms))


def solutions(problem: Problem) -> list[Solution]:
    """From the problem's own guess, then from perturbed ones."""
    return [solve(problem), *(solve(problem, perturb=NOISE, seed=seed) for seed in SEEDS)]


def iterations(found: Sequence[Solution]) -> str:
    """Iterations of every start; in brackets where it was not solved."""
    counts = [(str(s.meta["iterations"]) if s.success else f"({s.meta['iterations']})") for s in found]
    return ", ".join(counts)


def reached(goal: str, solution: Solution) -> float:
    """What a hop reached: the base's rise, the way, m; or the time, s."""
    rise, way = solution.q[:, 1].max() - solution.q[0, 1], solution.q[-1, 0] - solution.q[0, 0]
    return float({"height": rise, "distance": way, "time": solution.t[-1]}[goal])


def main() -> None:
    """Print both tables."""
    print("| goal | rest of effort | reached | root mean square torque, N m | check | iterations |")
    print("|---|---|---|---|---|---|")
    for goal in ("height", "distance", "time"):
        for rest in RESTS:
            found = solutions(with_rest(problems.load("hopper-hop", goal=goal), rest))
            own = found[0]
            failures = ", ".join(check(own).failures()) or "passes"
            torque = np.sqrt((own.tau**2).mean())
            figures = f"{reached(goal, own):.2f} | {torque:.0f} | {failures} | {iterations(found)}"
            print(f"| {goal} | {rest:g} | {figures} |", flush=True)
    print("\n| rounding | cost of transport | iterations |")
    print("|---|---|---|")
    problem = problems.load("hopper-gait", goal="transport")
    for smoothing in ROUNDINGS:
        found = solutions(rounded(problem, smoothing))
        costs = ", ".join(f"{cost_of_transport(solution):.3f}" for solution in found)
        print(f"| {smoothing:g} | {costs} | {iterations(found)} |", flush=True)
    least = cost_of_transport(solve(problems.load("hopper-gait")))
    print(f"\nof least effort: {least:.3f}")


if __name__ == "__main__":
    main()
