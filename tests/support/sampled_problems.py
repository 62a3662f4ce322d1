"""Solutions of every kind that the library makes, for what is done with solutions."""

from functools import lru_cache

import trajopt
from tests.support.problems import hop, landing
from tests.support.solved_problems import motion, solved, solved_hop
from trajopt.motion.solution import Solution
from trajopt.reduced.single_rigid_body import body_problem

# Problems of the library by what is particular about their solutions.
LIBRARY = {
    "torque": ("ur5-reach", {}),
    "acceleration": ("ur5-reach", {"actuation": "acceleration"}),
    "velocity": ("ur5-reach", {"actuation": "velocity"}),
    "continuous joints": ("arm-reach", {"robot": "kinova"}),
    "payload": ("arm-pick-place", {"robot": "panda"}),
    "grasp": ("ur5-pull", {}),
    "passive joint": ("double-pendulum", {}),
    "planar base": ("hopper-hop", {}),
    "minimal coordinates": ("hopper-hop", {"coordinates": "minimal"}),
    "drives": ("solo12-jump", {"voltage": 6.0}),
    "soles": ("biped-squat", {"robot": "talos"}),
    "virtual joints": ("solo12-flip", {"base": "virtual", "pitch": 1.0}),
}
MADE = {
    "points": lambda: solved_hop().solution,
    "an impact": lambda: solved(landing(impact=True), "radau:2", 8).solution,
    "free durations": lambda: solved(landing(free=True), "legendre:2", 8).solution,
    "one point": lambda: solved(hop(), "legendre:1", 24).solution,
    "classic": lambda: solved(hop(), "hermite-simpson", 8).solution,
    "a rigid body": lambda: trajopt.solve(body_problem(trajopt.load("solo12-jump"))),
}
KINDS = (*MADE, *LIBRARY)


@lru_cache
def solution_of_kind(kind: str) -> Solution:
    """A solution of one of ``KINDS``."""
    if kind in MADE:
        return MADE[kind]()
    name, settings = LIBRARY[kind]
    return motion(name, **settings)
