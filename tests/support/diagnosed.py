"""Small problems with their solutions, and what a diagnosis sees of them."""

from functools import lru_cache

import trajopt
from tests.support.problems import hop, lean, reach
from tests.support.redundant_contacts import solo_hop
from trajopt import Problem, Solution
from trajopt.solving.diagnosis.snapshot import Snapshot
from trajopt.solving.solving import prepare


@lru_cache
def solved(name: str) -> tuple[Problem, Solution]:
    problem = {"reach": reach, "lean": lean, "hop": hop, "solo": solo_hop}[name]()
    intervals = {"hop": 8, "solo": 9}.get(name)
    return problem, trajopt.solve(problem, intervals=intervals)


def snapshot_of(problem: Problem, solution: Solution) -> Snapshot:
    from trajopt.motion.grid import mesh_of
    from trajopt.solving.diagnosis.diagnose import at_solution

    return at_solution(prepare(problem, mesh=mesh_of(solution)), solution)
