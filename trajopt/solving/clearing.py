"""Solve a problem until its bodies are clear of each other along the whole motion."""

from __future__ import annotations

from typing import Any

from trajopt.problem.problem import Problem
from trajopt.solution.solution import Solution
from trajopt.solving.exchange import Exchange, PhaseMotion, along
from trajopt.solving.solving import solve
from trajopt.solving.verdicts import is_usable_start

# Most solves after the first.
MOST_ROUNDS = 8
# Planes are laid anew until the objective changes by less than this part of it: the motion that they allow is
# then the best one near it.
SETTLED = 5e-3


def solve_clear(problem: Problem, **options: Any) -> Solution:
    """Solve, and solve again with rows for the pairs that came too near; options as for `solve`.

    Returns the best clear motion, or the last one that was solved; `Exchange.missing` tells whether it is
    clear.
    """
    exchange, solution, clear = Exchange(problem), solve(problem, **options), list[Solution]()
    settled = True
    for number in range(MOST_ROUNDS + 1):
        if not is_usable_start(solution):
            break
        look = exchange.look(solution)
        missing = exchange.missing(look)
        clear += [] if missing else [solution]
        if (settled and not missing) or number == MOST_ROUNDS:
            break
        sideless = any(pair in exchange.outer_pairs and pair not in exchange.moments for pair in missing)
        exchange.add(look)
        again = _solved_again(exchange, solution, sideless, {**options, "label": f"clearing {number + 1}"})
        if not is_usable_start(again):
            break
        before, after = solution.meta["objective"], again.meta["objective"]
        settled = abs(after - before) <= SETTLED * max(abs(before), abs(after))
        solution = again
    return min(clear, key=lambda found: found.meta["objective"], default=solution)


def _solved_again(
    exchange: Exchange, solution: Solution, sideless: bool, options: dict[str, Any]
) -> Solution:
    """From the last motion or from the guess, whichever is on the right side; from the other if that fails.

    A motion that goes through an obstacle without rows yet (``sideless``) may be on no side of it; the guess
    of a problem with obstacles passes them where its author wants it to. From then on motions are on that
    side, and planes along them hold them back less than those along the guess.
    """
    starts: list[tuple[PhaseMotion, dict[str, Any]]] = [
        (along(solution), {**options, "start": solution}),
        (exchange.guess, options),
    ]
    if sideless and exchange.guess_is_clear():
        starts.reverse()
    for motion, settings in starts:
        found = solve(exchange.constrained(motion), **settings)
        if is_usable_start(found):
            break
    return found
