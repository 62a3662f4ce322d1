"""The hopper on a ball, and hops that end on any ground."""

from dataclasses import replace

import numpy as np

from tests.support.problems import FOOT, hop, hopper
from trajopt.problem.problem import Problem
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import FrameHeight, SwingClearance, swing_clearance
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.shapes import Incline, Wave
from trajopt.terrain.smooth import SmoothTerrain

RADIUS = 0.03
WAVES = SmoothTerrain(shapes=(Wave(amplitude=0.03, wavelength=0.5, at=(0.02, 0.0)), Incline(slope_y=0.1)))


def ball_hopper(radius: float = RADIUS) -> Robot:
    """The hopper of the tests with a ball as foot, standing on level ground."""
    robot = hopper()
    ball = Contact(frame=FOOT, radius=radius)
    q = robot.reference.copy()
    q[2] += radius
    return replace(robot, contacts=(ball,), reference=q)


def raised(problem: Problem, radius: float) -> Problem:
    """The same task for the hopper on a ball: everything is higher by its radius."""
    robot, up = ball_hopper(radius), radius * np.eye(8 + 1)[2]
    terms = tuple(
        replace(term, height=term.height + radius) if isinstance(term, FrameHeight) else term
        for term in problem.terms
    )
    return replace(
        problem,
        robot=robot,
        initial_q=problem.initial_q + up,
        guess=lambda t: problem.guess(t) + up,
        terms=terms,
    )


def landing_on(ground, robot: Robot, **phase: object) -> Problem:
    """A hop that ends on ``ground``, from where the robot's foot touches it."""
    start = robot.reference.copy()
    foot = contact_positions(robot, start)[FOOT]
    start[2] -= float(ground.offset(RADIUS).surface_at(foot).distance(foot)) / ground_slope(ground, foot)
    terms = tuple(term for term in hop().terms if not isinstance(term, FrameHeight))
    landing = Phase(name="landing", duration=0.3, contacts=(FOOT,), **phase)
    schedule = Schedule((*hop().schedule.phases[:2], landing))
    still = lambda t: start  # noqa: E731
    own: dict[str, object] = {"robot": robot, "schedule": schedule, "terrain": ground, "guess": still}
    if isinstance(ground, PiecewiseTerrain):
        terms += swing_clearance(robot, schedule, ground, height=0.02, guess=still)
    else:
        terms += (SwingClearance(height=0.02, terrain=ground),)
    return hop(**own, initial_q=start, terms=terms)


def ground_slope(ground, place: np.ndarray) -> float:
    """Vertical part of the normal under a position."""
    return float(ground.offset(RADIUS).surface_at(place).plane_at(place).normal[2])
