"""Discovery tasks without a catalogue problem: stand at a goal, or move periodically at a mean speed."""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt.arguments import Positive, checked
from trajopt.errors import InputError
from trajopt.problem.periodicity import Periodicity
from trajopt.problem.problem import Problem
from trajopt.reduced.over_terrain import standing_on
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.legs import on_feet
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.schedule.gaits import stride_period
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.study.discovery.task import CLEARANCE, ContactTask, require_feet
from trajopt.terms.friction import contact_cones
from trajopt.terms.interfaces import Term
from trajopt.terms.limits import PositionLimits, TorqueLimits, VelocityLimits
from trajopt.terms.objectives import effort_costs
from trajopt.terms.terminal import TerminalRest, TerminalState
from trajopt.terms.tracking import KeyFrames, TrackingCost
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.terrain import Terrain

# Default duration in units of sqrt(l / g): for push-off and coming to rest, and per robot length of the way.
STANDING, EACH_LENGTH = 4.0, 3.0
# Weight of the base's deviation from the mean motion of a cycle.
TRACKING = 0.1
# In robot lengths: distance of the fore feet from an edge at the start, and ground beyond the goal.
FROM_EDGE, BEYOND = 0.15, 3.0


@checked
@dataclass(frozen=True, kw_only=True)
class Destination:
    """Goal pose of a robot that starts standing at the origin, and the time to reach it.

    Args:
        x: forward, m.
        y: to the left, m.
        yaw: turn to the left, rad.
        duration: s; None derives it from the distance.
        duration_range: bounds of a free duration, s; None fixes the duration.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    duration: Positive | None = None
    duration_range: tuple[float, float] | None = None


@checked
def task_to(robot: Robot, goal: Destination, terrain: Terrain | None = None) -> ContactTask:
    """Build the task of reaching a goal from standing with the least torques, for `discover`.

    Raises:
        InputError: for a robot without feet on a moving base, an invalid duration range, or ground beyond the
            reach of its legs.
    """
    require_feet(robot)
    robot = on_feet(robot)
    ground = FlatGround() if terrain is None else terrain
    start, end = (_standing(robot, ground, place) for place in (Destination(), goal))
    unit = Units(robot).time
    way = math.hypot(goal.x, goal.y) / robot.length
    low, high = goal.duration_range or (0.0, 0.0)
    duration = goal.duration or (low + high) / 2 or (STANDING + EACH_LENGTH * way) * unit
    if goal.duration_range is not None and not 0 < low <= duration <= high < math.inf:
        raise InputError(
            f"the duration is between {low:g} and {high:g} s", "allowed: positive, the lower one first"
        )
    names = tuple(contact.name for contact in robot.contacts)
    phase = Phase(name="all", duration=duration, contacts=names, duration_bounds=goal.duration_range)
    costs = _costs_and_limits(robot)
    problem = Problem(
        name=f"{robot.name}-to-goal",
        robot=robot,
        schedule=Schedule((phase,)),
        terrain=ground,
        initial_q=start,
        terms=costs,
        guess=KeyFrames(robot, np.array([0.0, duration]), np.array([start, end])),
    )
    terms = (*costs, TerminalState(q=end), TerminalRest(q=end))
    return ContactTask(problem=problem, terms=terms, left_out=(), clearance=CLEARANCE * robot.length)


def _standing(robot: Robot, terrain: Terrain, place: Destination) -> np.ndarray:
    """The reference posture (nq,) moved to a place, with its feet on the ground there."""
    q = robot.reference.copy()
    if robot.base == "planar":
        if place.y or place.yaw:
            raise InputError(f"'{robot.name}' moves in a plane, the goal is beside it", "allowed: x alone")
        q[0] += place.x
        return q
    turn = pin.Quaternion(pin.utils.rotate("z", place.yaw) @ pin.Quaternion(q[3:7]).matrix())
    q[:2] = np.array([place.x, place.y]) + pin.utils.rotate("z", place.yaw)[:2, :2] @ q[:2]
    q[3:7] = turn.coeffs()
    return q if isinstance(terrain, FlatGround) else standing_on(replace(robot, reference=q), terrain)


@checked
def cycle_of(robot: Robot, speed: float, period: Positive | None = None) -> ContactTask:
    """Build the task of a periodic motion at a mean forward speed with the least torques, for `discover`.

    Args:
        robot: a robot with feet on a moving base.
        speed: mean forward speed, m/s.
        period: s; None uses `stride_period`.

    Raises:
        InputError: for a robot without feet on a moving base.
    """
    require_feet(robot)
    robot = on_feet(robot)
    duration = period or stride_period(robot, speed)
    motion = partial(_moving, robot, speed)
    # A cycle that a problem accepts; `discover` does not use it.
    names = tuple(contact.name for contact in robot.contacts)
    stand = Phase(name="stand", duration=duration / 2, contacts=names)
    flight = Phase(name="flight", duration=duration / 2)
    problem = Problem(
        name=f"{robot.name}-cycle",
        robot=robot,
        schedule=Schedule((stand, flight)),
        terms=(*_costs_and_limits(robot), TrackingCost(reference=motion, part="base", weight=TRACKING)),
        guess=motion,
        periodicity=Periodicity(velocity=(speed, 0.0, 0.0)),
        duration_bounds=(duration, duration),
    )
    return ContactTask.of(problem)


def _moving(robot: Robot, speed: float, t: float) -> np.ndarray:
    """The reference posture (nq,), moved forward at the given speed."""
    q = robot.reference.copy()
    q[0] += speed * t
    return q


def _costs_and_limits(robot: Robot) -> tuple[Term, ...]:
    limits = (TorqueLimits(), PositionLimits(), VelocityLimits())
    return (*effort_costs(), *limits, *contact_cones(robot.contacts))


def first_edge(robot: Robot) -> float:
    """x, m, at which ground ahead of the fore feet begins."""
    feet = np.array(list(contact_positions(robot, robot.reference).values()))
    return float(feet[:, 0].max()) + FROM_EDGE * robot.length


@checked
def obstacle(robot: Robot, kind: str, size: float, goal: Destination) -> PiecewiseTerrain:
    """A box of height or a gap of width ``size``, m, ahead of the fore feet; the goal is on or behind it."""
    feet, edge = np.array(list(contact_positions(robot, robot.reference).values())), first_edge(robot)
    if kind == "gap":
        return PiecewiseTerrain.gap(size, at=(edge, 0.0))
    length = goal.x + float(feet[:, 0].max()) + BEYOND * robot.length - edge
    return PiecewiseTerrain.box(
        size, length, float(np.ptp(feet[:, 1])) + 2 * BEYOND * robot.length, at=(edge + length / 2, 0.0)
    )
