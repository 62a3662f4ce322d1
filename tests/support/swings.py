"""An arm of three rods that swings past obstacles: seconds to solve, its least distances known."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import CapsuleObstacle, LinkShape, Obstacle, SphereObstacle
from trajopt.motion.solution import Solution
from trajopt.problem import PosturePath
from trajopt.problem.problem import Problem
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.graded import solve as solve_graded
from trajopt.terms import AccelerationCost, Clearance, TerminalRest, TerminalState
from trajopt.terrain.flat import FlatGround

LINK, SIDE, DURATION, MARGIN = 0.5, 0.06, 1.5, 0.02  # m, m, s, m
START, END = np.array([-0.3, 0.0, 0.0]), np.array([1.2, 0.0, 0.0])

BALL = SphereObstacle(name="ball", centre=[0.69, 0.0, 1.443], radius=0.1)
# Capsules around the rods.
ROD_CAPSULES = tuple(
    LinkShape.capsule(name, name, np.zeros(3), [0.0, 0.0, LINK], SIDE / np.sqrt(2))
    for name in ("joint0", "joint1", "joint2")
)
# In the middle of the way, where a link in a hurry may pass it between two points.
POLE = SphereObstacle(name="pole", centre=[0.55, 0.0, 1.15], radius=0.1)
FAR = CapsuleObstacle(name="far", start=[-3.0, 0.0, 0.0], end=[-3.0, 0.0, 1.0], radius=0.1)


@lru_cache
def rods() -> Robot:
    """Three equal links that turn about parallel axes, upright at zero, without meshes."""
    model, parent = pin.Model(), 0
    for i in range(3):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, LINK if i else 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"joint{i}")
        rod = pin.Inertia.FromBox(1.0, SIDE, SIDE, LINK)
        rod.lever = np.array([0.0, 0.0, LINK / 2])
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
        model.addJointFrame(parent)
    return Robot.from_model(model, name="rods", base="fixed")


def swing(start: np.ndarray = START, end: np.ndarray = END, **changes: object) -> Problem:
    """From rest at ``start`` to rest at ``end``, straight in joints if nothing forbids it.

    From upright to lying ahead by default, the links in line: through ball and pole.
    """
    robot = rods()
    given = {
        "name": "swing",
        "robot": robot,
        "schedule": Schedule((Phase(name="swing", duration=DURATION),)),
        "terrain": FlatGround(),
        "initial_q": start,
        "initial_v": np.zeros(robot.nv),
        "terms": (AccelerationCost(weight=1.0), TerminalState(q=end), TerminalRest(q=end)),
        "guess": PosturePath(model=robot.model, postures=(start, end), durations=(DURATION,)),
        "default_intervals": 30,
    }
    return Problem(**(given | changes))


def past(problem: Problem, *obstacles: Obstacle, **changes: object) -> Problem:
    """The problem, its links as capsules clear of obstacles; of each other too with ``self_collision``."""
    given = {"shapes": ROD_CAPSULES, "margin": MARGIN, "self_collision": False}
    return replace(problem, terms=(*problem.terms, Clearance(obstacles=obstacles, **(given | changes))))


@lru_cache
def avoided() -> tuple[Problem, Solution]:
    """The swing past the ball, solved until it is clear."""
    problem = past(swing(), BALL, FAR)
    return problem, solve_graded(problem, fixed_mesh=True)
