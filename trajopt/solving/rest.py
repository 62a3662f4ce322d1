"""The problem of a robot at rest in its reference posture: a first look at a new robot."""

import numpy as np

from trajopt.inspection.standing import standing_feet
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms.costs import AccelerationCost, WrenchCost
from trajopt.terms.friction import contact_cones
from trajopt.terrain.flat import FlatGround

# Long enough to look at, s; a motion at rest needs no fine grid.
DURATION, INTERVALS = 1.0, 4
# Weight of wrenches relative to accelerations: it distributes forces without changing the motion.
SPREAD = 1e-6
# Friction coefficient of rubber on a dry floor.
FRICTION = 0.7


def rest(robot: Robot, duration: float = DURATION) -> Problem:
    """Return the problem of staying in the reference posture for ``duration`` s, on the feet if any.

    The cost is on accelerations, with a small weight on wrenches to distribute them. Torques are not limited,
    and the robot starts at rest: a posture that is not balanced falls over.
    """
    feet = standing_feet(robot)
    spread = (WrenchCost(weight=SPREAD),) if feet else ()
    return Problem(
        name="rest",
        robot=robot,
        schedule=Schedule((Phase(name="rest", duration=duration, contacts=tuple(c.name for c in feet)),)),
        terrain=FlatGround(friction=FRICTION),
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=(AccelerationCost(weight=1.0), *spread, *contact_cones(feet)),
        guess=lambda _: robot.reference,
        default_intervals=INTERVALS,
    )
